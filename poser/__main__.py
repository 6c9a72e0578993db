"""The command line: `poser COMMAND ...`, one module a command in `poser/commands/`.

Exit status: 0 done, 1 could not do it, 2 wrong usage, 130 interrupted. Only what a command needs is
imported, and only once it runs, so that `poser --help` is quick.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Any, NoReturn

from poser import commands
from poser.console import DONE, FAILED, INTERRUPTED, WRONG_USAGE, UsageError, complain, tell_notes

DEBUG_HELP = "show where an error comes from"


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one sentence."""

    commands: Mapping[str, Parser] = {}

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse's; what a command does not know is told by that command, with the nearest option."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            command = self.commands.get(found.command, self)
            command.error(
                f"unrecognized arguments: {' '.join(unknown)}{command._nearest(unknown[0])}"
            )
        return found

    def _nearest(self, word: str) -> str:
        options = [o for o in self._option_string_actions if o.startswith("--")]
        near = difflib.get_close_matches(word.split("=")[0], options, 1)
        return f"; did you mean {near[0]}?" if near else ""

    def print_help(self, file: Any = None) -> None:
        """As argparse's, which says nothing where stdout cannot take it."""
        print(self.format_help(), end="", file=file)

    def error(self, message: str) -> NoReturn:
        complain(f"{message} (see {self.prog} --help)", self.prog)
        raise SystemExit(WRONG_USAGE)


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        from importlib.metadata import version

        print(f"poser {version('poser-imu')}")
        raise SystemExit(DONE)


def parser() -> Parser:
    """The whole command line."""
    top = Parser(
        prog="poser",
        description="Human pose from a few body-worn inertial sensors.",
        allow_abbrev=False,
    )
    top.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    top.add_argument("--debug", action="store_true", help=DEBUG_HELP)
    subparsers = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    top.commands = subparsers.choices
    for name in commands.NAMES:
        module = importlib.import_module(f"poser.commands.{name}")
        sub = subparsers.add_parser(
            name,
            help=module.HELP,
            description=module.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        module.add_arguments(sub)
        # Suppressed, so that it does not undo a --debug before the command.
        sub.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=DEBUG_HELP)
        sub.set_defaults(run=module.run)
    return top


def main(argv: list[str] | None = None) -> int:
    """Run the command line on `argv` (default: the process' own) and return the exit status."""
    if argv is None:
        _own_process()
    words = sys.argv[1:] if argv is None else argv
    name = "poser"
    tell_notes(keep=False)
    try:
        args = parser().parse_args(words)
        name = f"poser {args.command}"
        return _flushed(int(args.run(args)), name, tell_notes)
    except SystemExit as e:
        return _flushed(e.code if isinstance(e.code, int) else WRONG_USAGE, name)
    except Ended as e:
        complain(f"ended by {e}", name)
        return 128 + e.number
    except KeyboardInterrupt:
        complain("interrupted", name)
        return INTERRUPTED
    except BrokenPipeError:
        _forget_stdout()
        return FAILED
    except Exception as e:
        if _interrupted(e):
            complain("interrupted", name)
            return INTERRUPTED
        if "--debug" in words:
            traceback.print_exc()
        complain(*_sentence(e, name))
        return WRONG_USAGE if isinstance(e, UsageError) else FAILED


class Ended(KeyboardInterrupt):
    """A signal that asks the process to end: as after Ctrl-C, what is whole is kept."""

    def __init__(self, number: int):
        self.number = number
        super().__init__(signal.Signals(number).name)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    raise Ended(number)


def _flushed(status: int, name: str, then: Callable[[], None] = lambda: None) -> int:
    """The status, once stdout has taken everything; FAILED where it does not, as on a full disk."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        _forget_stdout()
        return FAILED
    except OSError as e:
        _forget_stdout()
        complain(f"stdout: {e.strerror or e}", name)
        return FAILED
    then()
    return status


def _interrupted(e: BaseException) -> bool:
    """Whether a Ctrl-C lies behind an error: an extension that is being imported turns it into another."""
    behind = e.__cause__ or e.__context__
    return isinstance(behind, KeyboardInterrupt) or (behind is not None and _interrupted(behind))


def _sentence(e: Exception, name: str) -> Sequence[str]:
    """What to tell the user of an exception, and the name of the command."""
    from mocap.errors import PoserError

    if isinstance(e, PoserError):
        return str(e), name
    if isinstance(e, MemoryError):
        return "not enough memory for this recording", name
    if isinstance(e, OSError) and e.strerror:
        where = f"{e.filename}: " if e.filename is not None else ""
        return f"{where}{e.strerror}", name
    if isinstance(e, ImportError) and e.name:
        return f"the package {e.name!r} that this needs cannot be imported: {e}", name
    kind = type(e).__name__
    return f"a fault of the program: {kind}: {e} (--debug before the command shows where)", name


def _own_process() -> None:
    """What may be changed where the process is ours: warnings of libraries are not for users, and a
    name that the terminal's encoding lacks is escaped."""
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup ignores it
            signal.signal(number, _end)
    if "--debug" not in sys.argv:
        warnings.simplefilter("ignore")
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _forget_stdout() -> None:
    """Nobody reads stdout any more: the flush at the interpreter's end must not fail again."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):
        return


if __name__ == "__main__":
    sys.exit(main())
