"""``python -m occlib.course``: make the student copies; with ``--ledger``, the tables of the ledger in README and docs."""

import argparse
import sys
from collections.abc import Sequence

from occlib.course import student_copies, write_generated


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the student copies, or the ledger's tables, and say what was written and what was kept."""
    parser = argparse.ArgumentParser("python -m occlib.course", description="Make the student copies of the notebooks.")
    parser.add_argument("folder", nargs="?", default="course", help="where to (default: course)")
    parser.add_argument("--ledger", action="store_true", help="write the ledger's tables in README and docs instead")
    options = parser.parse_args(arguments)
    try:
        if options.ledger:
            print(f"ledger: {', '.join(path.name for path in write_generated()) or 'nothing'} changed")
            return
        written, kept = student_copies(options.folder)
    except ValueError as error:
        sys.exit(f"course: {error}")
    print(f"{len(written)} student copies in {options.folder}/")
    for copy in kept:
        print(f"kept {copy}: there is work in it; rename it to get a fresh one")


if __name__ == "__main__":
    main()
