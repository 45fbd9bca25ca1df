"""The exercises of each chapter: what is right, and the hint for each known mistake. One module a chapter."""
