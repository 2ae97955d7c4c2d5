"""The one command, ``apex``: finds the verb, runs it, and turns errors into one plain line.

Verbs register under the entry-point group ``apex_edge.verbs``, so nothing behind a verb is
imported before it is asked for: ``apex --help`` needs neither numpy nor OpenCV.
"""

import argparse
import logging
import os
import signal
import sys
import threading
from contextlib import contextmanager
from typing import Any, Iterator, List, Optional, Sequence

from apex_edge import __version__, plugins
from apex_edge.errors import ApexError, PluginError

# One line each for the built-in verbs, so that --help imports none of them.
BUILT_IN = {
    "arm": "find an arm, ask it, move it within its limits, stop it",
    "bench": "measure this machine: roll-outs side by side",
    "calibrate": "measure lens, table, hand-eye, colours, servos, latency; print boards",
    "demo": "a collision, a quiet and an implicit scene; no hardware needed",
    "doctor": "what is missing for the demo, a camera, an arm, a language model",
    "record": "record a camera to a file that Foxglove opens",
    "replay": "run the agent over a recording or a video, without an arm",
    "run": "run the agent on a real camera and arm",
    "sim-arm": "a simulated arm on a serial port, with faults on request",
    "train": "train, certify and export hazard triggers",
}
# What to install for a module that is only there with an extra.
EXTRA_OF = {
    "distributed": "distributed",
    "joblib": "train",
    "matplotlib": "train",
    "mujoco": "offline",
    "optuna": "sweep",
    "sklearn": "train",
    "threadpoolctl": "train",
    "torch": "graph",
    "torch_geometric": "graph",
    "yaml": "hiwonder",
}
VERB_PARTS = ("HELP", "EXAMPLE", "add_arguments", "run")
INTERRUPTED = 130


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Run ``apex`` and return its exit code: 0 only on success.

    2 is a typed error or a wrong command line, 130 Ctrl-C, 128 + n a signal.
    """
    # OpenCV and FFmpeg print their own lines before our one that says what to do
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    arguments = list(sys.argv[1:] if argv is None else argv)
    args, rest = _top_parser().parse_known_args(_before_verb(arguments))
    is_debug = args.debug or "--debug" in arguments
    try:
        with _signals_unwind():
            if args.verb is None:
                if rest:
                    _write(sys.stderr, f"apex: unknown option {rest[0]}; see apex --help\n")
                    return 2
                _write(sys.stdout, _overview())
                return 0 if args.help else 2
            return _run_verb(args.verb, arguments, rest)
    except KeyboardInterrupt:
        _write(sys.stderr, "apex: interrupted\n")
        return INTERRUPTED
    except BrokenPipeError:
        # the reader (head, less) is gone; keep the interpreter from complaining at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (ApexError, ImportError, OSError) as error:
        if is_debug:
            raise
        _write(sys.stderr, _explain(error))
        return error.exit_code if isinstance(error, ApexError) else 2


def _top_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="apex", add_help=False, usage="apex VERB [options]")
    parser.add_argument("verb", nargs="?")
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("--version", action="version", version=f"apex {__version__}")
    _add_common(parser)
    return parser


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-v", "--verbose", action="count", default=0, help="-v state, -vv detail")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")


def _before_verb(arguments: List[str]) -> List[str]:
    """Return the arguments up to and including the verb; the rest belongs to the verb."""
    for position, argument in enumerate(arguments):
        if not argument.startswith("-"):
            return arguments[: position + 1]
    return arguments


def _run_verb(name: str, arguments: List[str], unknown: List[str]) -> int:
    verb = _load_verb(name)
    parser = argparse.ArgumentParser(
        prog=f"apex {name}",
        description=verb.HELP,
        epilog=f"example:\n  {verb.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_common(parser)
    verb.add_arguments(parser)
    if unknown:
        parser.error(f"put {' '.join(unknown)} after the verb")
    # options written before the verb (apex -v demo) count as well
    position = arguments.index(name)
    args = parser.parse_args(arguments[:position] + arguments[position + 1 :])
    _set_up_logging(args.verbose)
    code = verb.run(args)
    return int(code)


def _load_verb(name: str) -> Any:
    verb = plugins.load("verbs", name)
    missing = [part for part in VERB_PARTS if not hasattr(verb, part)]
    if missing:
        raise PluginError(f"the plug-in behind verb {name!r} has no {', '.join(missing)}")
    return verb


def _overview() -> str:
    lines = [
        "usage: apex VERB [options]",
        "",
        "Sees a table, anticipates a collision and moves a cheap arm in between, in time.",
        "",
        "verbs:",
    ]
    lines += [f"  {name:<11}{_help_line(name)}" for name in plugins.names("verbs")]
    lines += [
        "",
        "options (before or after the verb):",
        "  -h, --help     this, or the help of a verb: apex VERB --help",
        "  --version      print the version",
        "  -v, -vv        log state changes, or details",
        "  --debug        show the traceback of an error",
        "",
        "example:",
        "  apex demo",
    ]
    return "\n".join(lines) + "\n"


def _help_line(name: str) -> str:
    if name in BUILT_IN:
        return BUILT_IN[name]
    try:
        return str(_load_verb(name).HELP)
    except PluginError as error:
        return f"(not usable: {error})"


def _set_up_logging(verbosity: int) -> None:
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbosity, 2)]
    logging.basicConfig(level=level, format="%(levelname)s %(name)s: %(message)s")


def _explain(error: Exception) -> str:
    cause = error.__cause__ if isinstance(error, PluginError) else error
    if isinstance(cause, ImportError):
        extra = EXTRA_OF.get((cause.name or "").split(".")[0])
        if extra:
            return (
                f"apex: this needs {cause.name}, which is not installed\n"
                f"  install it with: {sys.executable} -m pip install 'apex-edge[{extra}]'\n"
            )
    slug = f"\n  see docs/errors.md#{error.slug}" if isinstance(error, ApexError) else ""
    return f"apex: {error}{slug}\n"


def _write(stream: Any, text: str) -> None:
    stream.write(text)
    stream.flush()


def _exit_on_signal(number: int, _frame: Any) -> None:
    sys.exit(128 + number)


@contextmanager
def _signals_unwind() -> Iterator[None]:
    """Let SIGTERM and a lost terminal unwind like Ctrl-C: the arm is stopped on the way."""
    kept = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            # nohup set it to be ignored: leave that
            if signal.getsignal(number) is signal.SIG_DFL:
                kept[number] = signal.signal(number, _exit_on_signal)
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


if __name__ == "__main__":
    sys.exit(main())
