"""The site as one file, which goes into the archives of a release."""

import zipfile
from pathlib import Path

LARGEST = 5_000_000  # bytes
# The oldest that a zip can have: the same files give the same bytes on every day.
DATE = (1980, 1, 1, 0, 0, 0)


def pack(html: Path, to: Path) -> None:
    """Write the files of a folder to the zip `to`, the same bytes for the same files.

    **Raises:** `ValueError` for one of more than 5 MB."""
    with zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(each for each in html.rglob("*") if each.is_file()):
            entry = zipfile.ZipInfo(path.relative_to(html).as_posix(), DATE)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, path.read_bytes())
    if to.stat().st_size > LARGEST:
        raise ValueError(
            f"The pages take {to.stat().st_size / 1e6:.1f} MB, more than 5 MB."
        )
