"""The content of a TOML file."""

import tomllib
from pathlib import Path
from typing import Any

MARK = "\ufeff"  # which some editors put first


def read_toml(path: Path, refusal: type[ValueError] = ValueError) -> dict[str, Any]:
    """The content of the file `path`, with or without a byte mark before it.

    **Raises:** `refusal` for text that is not TOML; `OSError` where it cannot be opened.
    """
    return text_and_content(path, refusal)[1]


def text_and_content(
    path: Path, refusal: type[ValueError] = ValueError
) -> tuple[str, dict[str, Any]]:
    """The text of the file `path`, and its content, with or without a byte mark before it.

    **Raises:** `refusal` for text that is not TOML; `OSError` where it cannot be opened.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return text, tomllib.loads(text.removeprefix(MARK))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise refusal(f"{path} is not valid TOML: {error}") from error
    except RecursionError:
        raise refusal(f"{path} is not valid TOML: it is nested too deeply") from None
