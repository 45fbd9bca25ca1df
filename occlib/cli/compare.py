"""``occlib compare``: a template looked for in an image with each measure."""

from __future__ import annotations

import argparse
import json

from occlib.cli.options import Commands, add_command, check_png, one_of, threshold


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(
        commands, "compare", "Look for a template in an image with each measure: a table, and a picture.", compare
    )
    p.add_argument("image", metavar="IMAGE", help="read as 8 bit")
    p.add_argument("template", metavar="TEMPLATE", help="a picture no larger than the image")
    methods = p.add_argument("--methods", nargs="+", metavar="NAME", help="measures; all by default")
    p.add_argument("--matchers", metavar="FILE.py", help="a file that registers matchers of your own")
    level = p.add_argument(
        "--threshold", type=threshold, metavar="T", help="by name, or a score; by default what suits the template"
    )
    p.add_argument("--mask", metavar="IMAGE", help="weights of the template's pixels, black: not counted")
    rule = p.add_argument("--rule", default="components", metavar="NAME", help="which places of the good ones count")
    p.add_argument("--colour", action="store_true", help="compare in colour; grey by default")
    p.add_argument("--out", default="compare.png", metavar="FILE.png", help="the picture (compare.png)")
    p.add_argument("--json", action="store_true", help="print one JSON object instead of the table")

    def complete() -> None:
        from occlib.matching import METHODS
        from occlib.matching.optima import RULES
        from occlib.matching.thresholds import THRESHOLDS

        lower, higher = (one_of(n for n, m in METHODS.items() if m.higher_is_better == up) for up in (False, True))
        p.epilog = f"x, y: the template's top-left px at the best place. 0 is best for {lower}; 1 for {higher}."
        methods.help = f"{one_of(METHODS)}; all by default"
        level.help = f"{one_of(THRESHOLDS)} or a score; by default what suits the template"
        rule.help = one_of(RULES, default="components")

    p.complete_help(complete)


def compare(args: argparse.Namespace) -> int:
    """Print what each measure found, and draw it."""
    check_png(args.out, "--out")
    from occlib.study import compare_pictures, comparison_rows

    results = compare_pictures(
        args.image,
        args.template,
        args.methods,
        mask=args.mask or None,
        threshold=args.threshold,
        rule=args.rule,
        colour=args.colour,
        matchers=args.matchers or None,
        out=args.out,
    )
    rows = comparison_rows(results)
    if args.json:
        found = {
            name: [{"centre_px": match.centre_px, "score": match.score} for match in result.matches]
            for name, result in results.items()
        }
        finite = {name: {key: _finite(value) for key, value in row.items()} for name, row in rows.items()}
        print(json.dumps({name: {**row, "found": found[name]} for name, row in finite.items()}))
        return 0
    print(_table(rows))
    if blank := [name for name, row in rows.items() if row["best"] is None]:
        print(f"{', '.join(blank)}: the same score everywhere; the template or the image has no contrast, or no edges")
    print(f"{args.out}: similarity images, thresholds and matches")
    return 0


def _finite(value: float | None) -> float | None:
    return value if value is not None and abs(value) < float("inf") else None


def _table(rows: dict[str, dict[str, float | None]]) -> str:
    """Named rows in columns, numbers to four digits and ``-`` for none."""
    lines = [["", *next(iter(rows.values()))]]
    lines.append(["method"] + [""] * (len(lines[0]) - 1))
    for name, row in rows.items():
        lines.append(
            [
                name,
                *("-" if v is None or v != v else f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()),
            ]
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in lines]
    return "\n".join(text.rstrip() for text in texts)
