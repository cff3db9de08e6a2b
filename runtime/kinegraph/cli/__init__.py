"""The command line: `kinegraph generate | compose | sequence | edit | batch | retarget | view | play | serve ...`.

Exit codes: 0 success; 2 invalid input, bundle or target (one line on stderr says why); 130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Final, NoReturn

from kinegraph import __version__
from kinegraph.cli.arguments import (
    add_batch,
    add_bench,
    add_bundle,
    add_compose,
    add_edit,
    add_generate,
    add_inbetween,
    add_info,
    add_parse,
    add_play,
    add_retarget,
    add_sequence,
    add_serve,
    add_timeline,
    add_view,
)
from kinegraph.cli.batch import batch
from kinegraph.cli.character import retarget
from kinegraph.cli.console import one_line
from kinegraph.cli.editing import edit, inbetween
from kinegraph.cli.generate import compose, generate, sequence, timeline
from kinegraph.cli.inspect import info, parse, run_bench, verify
from kinegraph.cli.pages import play, serve, view
from kinegraph.errors import Cancelled, KinegraphError

# Modules that load numpy or onnxruntime are imported where they are used: `--help` must be instant.

EXIT_ERROR: Final = 2
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141
"""128 + SIGPIPE, as a shell reports a program that wrote to a closed pipe."""

AddArguments = Callable[[argparse.ArgumentParser], None]
Run = Callable[[argparse.Namespace], int]

COMMANDS: Final[tuple[tuple[str, str, AddArguments, Run], ...]] = (
    ("generate", "make a clip from a sentence or a graph", add_generate, generate),
    ("compose", "make a clip of several motions at once, or without some", add_compose, compose),
    ("sequence", "make a clip of several sentences, one after another", add_sequence, sequence),
    ("timeline", "make a clip of sentences that hold from one moment to another", add_timeline, timeline),
    ("edit", "keep a part of a saved clip, and make the rest anew", add_edit, edit),
    ("inbetween", "make the motion from one saved clip to another", add_inbetween, inbetween),
    ("batch", "make a clip of every row of a table, on all cores", add_batch, batch),
    ("retarget", "put a saved clip on a character", add_retarget, retarget),
    ("view", "show saved clips in the browser", add_view, view),
    ("play", "make clips in the browser, on this machine", add_play, play),
    ("serve", "make clips for other programs, over HTTP", add_serve, serve),
    ("parse", "print or draw the semantic graph of a sentence", add_parse, parse),
    ("info", "describe a bundle: abilities, licences, provenance, sizes, quality", add_info, info),
    ("verify", "check every file, operator and session of a bundle", add_bundle, verify),
    ("bench", "measure the speed of a bundle on this machine, stage by stage", add_bench, run_bench),
)
"""Name, help, function that adds its arguments, and function that runs it and returns the exit code."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code; argparse itself exits with 0 or 2.

    Args:
        argv: arguments after the name of the program; None takes those of the process.
    """
    args, unread = _parser().parse_known_args(argv)
    if unread:
        args.command.refuse(unread)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal without Unicode shows an escape instead of ending the program.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        code: int = args.run(args)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader (head, less) is gone. Python would complain once more while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except (KeyboardInterrupt, Cancelled):
        print("kinegraph: cancelled", file=sys.stderr)
        return EXIT_INTERRUPTED
    except MemoryError:
        print("kinegraph: error: memory ran out; ask for less at once", file=sys.stderr)
        return EXIT_ERROR
    except KinegraphError as error:
        print(f"kinegraph: error: {one_line(error)}", file=sys.stderr)
        return EXIT_ERROR
    return code


class _OneLineParser(argparse.ArgumentParser):
    """Parser that tells what is wrong in one line, without the whole usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_ERROR, f"{self.prog}: error: {one_line(message)}; `{self.prog} --help` lists what it takes\n")

    def refuse(self, unread: Sequence[str]) -> NoReturn:
        """Refuse words that no argument takes, and say what may have been meant."""
        options = [option for action in self._actions for option in action.option_strings]
        first = next((word for word in unread if word.startswith("-")), unread[0])
        name = first.partition("=")[0]
        near = [option for option in options if option.startswith(name)] or difflib.get_close_matches(name, options, 1)
        meant = (
            f"; did you mean {near[0]}?" if near else "" if first.startswith("-") else "; a sentence goes into quotes"
        )
        self.error(f"unrecognized arguments: {' '.join(unread)}{meant}")


def _parser() -> argparse.ArgumentParser:
    parser = _OneLineParser(
        prog="kinegraph",
        description="A sentence in, a clip of human motion out, on a plain CPU.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"kinegraph {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, description, add_arguments, run in COMMANDS:
        command = commands.add_parser(name, help=description, allow_abbrev=False)
        add_arguments(command)
        command.set_defaults(run=run, command=command)
    return parser
