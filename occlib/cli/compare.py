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
    from occlib.study import compare_pictures, comparison_table

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
    table = comparison_table(results)
    if args.json:
        rows = json.loads(table.to_json(orient="index"))
        for name, result in results.items():
            rows[name]["found"] = [{"centre_px": match.centre_px, "score": match.score} for match in result.matches]
        print(json.dumps(rows))
        return 0
    text = table.assign(**{name: table[name].astype(object).where(table[name].notna(), "-") for name in ("x", "y")})
    print(text.to_string(float_format="{:.4g}".format, na_rep="-"))
    if blank := [str(name) for name in table.index[table["best"].isna()]]:
        print(f"{', '.join(blank)}: the same score everywhere; the template or the image has no contrast, or no edges")
    print(f"{args.out}: similarity images, thresholds and matches")
    return 0
