"""`kinegraph view | play | serve`: show clips in the browser, or answer other programs over HTTP."""

from __future__ import annotations

import argparse
from pathlib import Path

from kinegraph.cli.inputs import load_pipeline
from kinegraph.errors import InvalidInputError, MissingExtraError


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
        from kinegraph.playground.server import listen_at, open_browser, serve
    except ModuleNotFoundError as error:
        raise MissingExtraError(f'kinegraph play needs {error.name}: pip install "kinegraph[text,play]"') from error

    listener, token = listen_at(args.host, args.port, args.token)

    def on_start(url: str) -> None:
        if token is not None:
            print(qr_code(url))
        print(f"{url} (Ctrl+C ends it)", flush=True)
        if args.browser:
            open_browser(url)

    with listener:
        pipeline = load_pipeline(args.bundle, args.threads, parses=True)
        try:
            serve(pipeline, listener, on_start, token)
        except KeyboardInterrupt:
            return 0  # the normal end
    return 0


def qr_code(text: str) -> str:
    """Draw a QR code with blocks of a terminal, two rows in a line, in the terminal's own colours turned round."""
    import io

    import segno

    drawing = io.StringIO()
    segno.make(text, error="l", micro=False).terminal(out=drawing, compact=True, border=2)
    return drawing.getvalue()


def serve(args: argparse.Namespace) -> int:
    """Run `kinegraph serve`: answer other programs until Ctrl+C, then print the times of the stages."""
    try:
        from kinegraph.playground.server import open_socket, token_of
        from kinegraph.service.server import serve as run
    except ModuleNotFoundError as error:
        raise MissingExtraError(f'kinegraph serve needs {error.name}: pip install "kinegraph[text,play]"') from error
    token = token_of(args.token)
    if args.characters is not None and not args.characters.is_dir():
        raise InvalidInputError(f"there is no folder {str(args.characters)!r}")
    with open_socket(args.host, args.port, token) as listener:
        pipeline = load_pipeline(args.bundle, args.threads, parses=True)
        service = run(
            pipeline, listener, token, args.characters, lambda url: print(f"{url}v1/docs (Ctrl+C ends it)", flush=True)
        )
    print(service.times.summary())
    return 0
