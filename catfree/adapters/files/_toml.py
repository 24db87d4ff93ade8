"""Reading of TOML files within limits of time and recursion depth."""

import re
import tomllib
from typing import Any

from catfree.adapters.files._documents import StrPath, read_text
from catfree.errors import FileFormatError, quoted

_STRING = re.compile(r'"(?:[^"\\\n]|\\.)*"?|\'[^\'\n]*\'?')


def read_toml(path: StrPath, meaning: str, largest: int, dots: int) -> dict[str, Any]:
    """Read a TOML file of limited size.

    The parser's time and recursion depth grow much faster than the file, and fastest with the parts
    of a dotted key.

    Args:
        path: the file.
        meaning: description for messages: `calibration`.
        largest: most characters in the file.
        dots: most dots in a line outside of strings, as in decimal numbers.

    Raises:
        InvalidInputError: if there is no such file.
        FileFormatError: if it is too long, a line has too many dots, or it is not TOML.
    """
    text = read_text(path, meaning)
    if len(text) > largest:
        raise FileFormatError(
            f"{path} has {len(text)} characters; a {meaning} has at most {largest}."
        )
    for at, line in enumerate(_STRING.sub('""', text).split("\n"), start=1):
        if line.count(".") > dots:
            raise FileFormatError(
                f"{path}: line {at} has {line.count('.')} dots; a {meaning} has at most {dots} per "
                "line."
            )
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(
            f"{path} is not valid TOML ({quoted(error)}). Is the file complete?"
        ) from error
