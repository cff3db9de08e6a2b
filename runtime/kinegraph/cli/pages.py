"""`kinegraph view | play`: clips in the browser, from a file or from a server on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from kinegraph.cli.inputs import load
from kinegraph.errors import MissingExtraError


def view(options: argparse.Namespace) -> int:
    """One page of saved clips."""
    import tempfile
    import webbrowser

    from kinegraph.files import check_target, write_atomically
    from kinegraph.formats.html import page
    from kinegraph.formats.npz import read_npz

    if options.output is not None:
        check_target(options.output, options.force, (".html",))
    data = page([read_npz(path) for path in options.clips])
    target = options.output or Path(tempfile.mkdtemp(prefix="kinegraph-")) / "clips.html"
    write_atomically(target, data, force=options.force)
    print(target)
    if options.browser:
        webbrowser.open(target.resolve().as_uri())
    return 0


def play(options: argparse.Namespace) -> int:
    """The playground, until Ctrl+C."""
    try:
        from kinegraph.playground.server import listen, open_browser, serve
    except ModuleNotFoundError as error:
        raise MissingExtraError(f'kinegraph play needs {error.name}: pip install "kinegraph[text,play]"') from error

    def started(url: str) -> None:
        print(f"{url} (Ctrl+C ends it)", flush=True)
        if options.browser:
            open_browser(url)

    with listen(options.port) as listener:
        pipeline = load(options.bundle, options.threads, True)
        try:
            serve(pipeline, listener, started)
        except KeyboardInterrupt:
            return 0  # how it is meant to end
    return 0
