"""``python -m occlib.lab``: random rooms rendered to where they are kept."""

from __future__ import annotations

import argparse
import sys
import time

from occlib.base.interrupts import stoppable
from occlib.lab.engine import llvm_version
from occlib.lab.manifest import write_manifest
from occlib.lab.room_lists import LISTS, SHIPPED, SPP, listed_room
from occlib.recordings import ROOMS


def main(arguments: list[str] | None = None) -> int:
    """Render the rooms of lists, or of single seeds, that are not there yet."""
    from tqdm import tqdm

    parser = argparse.ArgumentParser(prog="python -m occlib.lab", description=main.__doc__)
    known = ", ".join(f"{name} ({len(seeds)} rooms)" for name, seeds in LISTS.items())
    parser.add_argument(
        "what", nargs="*", default=["some"], metavar="LIST|SEED", help=f"{known}, or seeds; some by default"
    )
    wanted = parser.parse_args(arguments).what
    start = time.perf_counter()
    try:
        if unknown := [each for each in wanted if each not in LISTS and not each.isdecimal()]:
            raise ValueError(f"expected a seed or one of {', '.join(LISTS)}, got {unknown[0]!r}")
        seeds = [seed for each in wanted for seed in (LISTS[each] if each in LISTS else (int(each),))]
        with stoppable():
            folders = [listed_room(seed) for seed in tqdm(seeds, desc="rooms", unit="room")]
        if set(SHIPPED) <= set(seeds):
            write_manifest(ROOMS, spp=SPP, llvm=llvm_version())
    except ValueError as error:
        print(f"rooms: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("rooms: interrupted; what is rendered is kept", file=sys.stderr)
        return 130
    print(f"{len(folders)} rooms in {folders[-1].parent} ({time.perf_counter() - start:.0f} s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
