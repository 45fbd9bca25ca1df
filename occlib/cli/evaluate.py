"""``occlib evaluate``: objects scored against the truth."""

from __future__ import annotations

import argparse
import json

from occlib.cli.options import Commands, add_command


def add(commands: Commands) -> None:
    """Add the command and its options."""
    p = add_command(commands, "evaluate", "Score objects.jsonl against truth.json.", evaluate)
    p.add_argument("objects", metavar="OBJECTS.jsonl")
    p.add_argument("truth", metavar="TRUTH.json")
    p.add_argument("--roi", metavar="NAME", help="count only inside this region of the truth file")
    p.add_argument("--radius", type=float, default=0.5, metavar="M", help="matches are closer than this (0.5 m)")
    p.add_argument("--json", action="store_true", help="print one JSON object")


def evaluate(args: argparse.Namespace) -> int:
    """Print the scores, as a table or as JSON."""
    from occlib import metrics
    from occlib.formats import load_objects, load_truth

    objects, truth = load_objects(args.objects), load_truth(args.truth)
    hidden = metrics.evaluate_hidden(objects, truth, roi=args.roi, radius=args.radius)
    scores = {
        **metrics.evaluate(objects, truth, roi=args.roi, radius=args.radius).to_dict(),
        "hidden_precision": hidden.precision,
        "hidden_recall": hidden.recall,
    }
    if args.json:
        print(json.dumps(scores))
    else:
        for name, value in scores.items():
            print(f"{name:>16}  {'-' if value is None else f'{value:.4g}' if isinstance(value, float) else value}")
    return 0
