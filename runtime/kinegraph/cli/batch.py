"""`kinegraph batch`: clips of a table of sentences, on all cores."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Final

from kinegraph.cli.console import as_json
from kinegraph.errors import InvalidInputError

_LINE_EVERY: Final = 0.1
"""Seconds between two progress lines at least."""


def batch(args: argparse.Namespace) -> int:
    """Run `kinegraph batch`; 2 if a row failed."""
    from kinegraph.batch import MANIFEST, BatchOptions, make_batch, read_table, unfinished

    if args.workers is not None and not 1 <= args.workers <= 1024:
        raise InvalidInputError(f"workers must be 1 to 1024, not {args.workers}")
    rows = read_table(args.table, args.seed)
    options = BatchOptions(
        suffix=args.format,
        bundle=None if args.bundle is None else str(args.bundle),
        fps=args.fps,
        names=args.names,
        root=args.root,
        in_place=args.in_place,
        loop=args.loop,
        strict=args.strict,
        character=None if args.character is None else str(args.character),
    )
    options.check()
    total, start, shown = len(unfinished(rows, args.output, options)), time.perf_counter(), 0.0
    visible = (args.progress or sys.stderr.isatty()) and not args.quiet
    made = failed = unknown = noted = 0
    for record in make_batch(rows, args.output, options, workers=args.workers):
        failed += "error" in record
        made += "error" not in record
        unknown += bool(record.get("unknown"))
        noted += bool(record.get("notes"))
        now = time.perf_counter()
        if visible and (now - shown > _LINE_EVERY or made + failed == total):
            rate = (made + failed) / (now - start)
            left = (total - made - failed) / rate
            line = f"\r\x1b[K{made + failed}/{total} clips, {rate:.1f} a second, {left:.0f} s left"
            print(line, end="\n" if made + failed == total else "", file=sys.stderr, flush=True)
            shown = now
    summary = {"folder": str(args.output), "made": made, "failed": failed, "kept": len(rows) - total}
    summary |= {"unknown": unknown, "notes": noted}
    if args.json:
        print(as_json(summary))
    elif not args.quiet:
        print(f"{args.output}: {made} clips made, {len(rows) - total} there already, {failed} failed")
    if unknown or noted:
        told = f"{unknown} of {made} clips have words that are not known, {noted} have notes"
        print(f"kinegraph: {told}; {args.output / MANIFEST} says which", file=sys.stderr)
    if failed:
        print(f"kinegraph: {failed} of {len(rows)} rows failed; {args.output / MANIFEST} says why", file=sys.stderr)
    return 2 if failed else 0
