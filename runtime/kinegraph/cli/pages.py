"""`kinegraph view | play`: show clips in the browser, from a file or from a server on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from kinegraph.cli.inputs import load_pipeline
from kinegraph.errors import MissingExtraError


def view(args: argparse.Namespace) -> int:
    """Run `kinegraph view`: write one page with saved clips."""
    import tempfile
    import webbrowser

    from kinegraph.files import check_target, write_atomically
    from kinegraph.formats import read
    from kinegraph.formats.html import clips_page

    if args.output is not None:
        check_target(args.output, args.force, (".html",))
    data = clips_page([read(path) for path in args.clips])
    target = args.output or Path(tempfile.mkdtemp(prefix="kinegraph-")) / "clips.html"
    write_atomically(target, data, force=args.force)
    print(target)
    if args.browser:
        webbrowser.open(target.resolve().as_uri())
    return 0


def play(args: argparse.Namespace) -> int:
    """Run `kinegraph play`: serve the playground until Ctrl+C."""
    try:
        from kinegraph.playground.server import listen, open_browser, serve
    except ModuleNotFoundError as error:
        raise MissingExtraError(f'kinegraph play needs {error.name}: pip install "kinegraph[text,play]"') from error

    def on_start(url: str) -> None:
        print(f"{url} (Ctrl+C ends it)", flush=True)
        if args.browser:
            open_browser(url)

    with listen(args.port) as listener:
        pipeline = load_pipeline(args.bundle, args.threads, parses=True)
        try:
            serve(pipeline, listener, on_start)
        except KeyboardInterrupt:
            return 0  # the normal end
    return 0
