"""``python -m occlib.cli``: the same as ``occlib``."""

from occlib.cli.commands import main

raise SystemExit(main())
