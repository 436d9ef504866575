"""The content of a TOML file."""

import tomllib
from pathlib import Path
from typing import Any


def read_toml(path: Path, refusal: type[ValueError] = ValueError) -> dict[str, Any]:
    """The content of the file `path`, with or without a byte mark before it.

    **Raises:** `refusal` for text that is not TOML; `OSError` where it cannot be opened.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise refusal(f"{path} is not valid TOML: {error}") from error
    except RecursionError:
        raise refusal(f"{path} is not valid TOML: it is nested too deeply") from None
