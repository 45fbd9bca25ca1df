"""What the chapters call: their tables and their longer drawings. One module a chapter, named after the notebook."""
