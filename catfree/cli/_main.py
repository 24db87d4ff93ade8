"""The command line as a function."""

import inspect
import re
import sys
from collections.abc import Callable, Sequence

import catfree
from catfree.cli._terminal import FAILURE, INTERRUPTED, fail, print_text, require_tyro
from catfree.errors import CatFreeError, InvalidInputError


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: the arguments after `catfree`; None for those of the process. `--version` alone
            prints the version.

    Returns:
        The exit code: 0, or 1 after an error. An error prints one sentence on standard error, or
        nothing if the reader of the output ended, as `head` does. Invalid arguments exit with 2.
    """
    words = sys.argv[1:] if arguments is None else arguments
    try:
        if words == ["--version"]:
            print_text(f"catfree {catfree.__version__}")
            return 0
        _require_no_empty(words)
        tyro = require_tyro()
        from catfree.cli._commands import COMMANDS  # needs tyro

        for command in COMMANDS.values():
            inspect.unwrap(command).__doc__ = _in_whole_lines(command)
        code = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="catfree",
            description="Track people on the ground from videos of static cameras. "
            "`--version` prints the version.",
            args=arguments,
        )
    except CatFreeError as error:
        return fail(str(error))
    except BrokenPipeError:
        return FAILURE
    except OSError as error:
        return fail(f"{error.filename or 'A file'}: {error.strerror or error}.")
    except KeyboardInterrupt:
        fail("Interrupted. A command with a cache resumes from the finished stages.")
        return INTERRUPTED
    return code or 0


def _require_no_empty(words: Sequence[str]) -> None:
    """Raise if an argument is empty, e.g. an unset variable: its path would be the current folder.

    Raises:
        InvalidInputError: naming the option, or the argument by its position.
    """
    for at, word in enumerate(words):
        before = words[at - 1] if at else ""
        if word.startswith("--") and word.endswith("="):
            name = word.removesuffix("=")
        elif not word:
            name = before if before.startswith("--") else f"Argument {at + 1}"
        else:
            continue
        raise InvalidInputError(f"{name} is empty. Give a value, or '.' for the current folder.")


def _in_whole_lines(command: Callable[..., int | None]) -> str:
    """Join the lines of each argument in a docstring, whose breaks tyro would keep."""
    return re.sub(r"\n {8,}", " ", inspect.getdoc(command) or "")
