"""An exported module as an FMU for co-simulation."""

import hashlib
import importlib.util
import io
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from .. import __version__
from .._interrupts import discard, unfinished
from .._written import write_files
from ._fields import Field
from ._fmu_source import Variable, fmu_source, variables

# Platforms by their names in FMI 3, with what the ziglang wheel calls them; of Linux the
# oldest C library that is still about.
TARGETS = {
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "aarch64-windows": "aarch64-windows-gnu",
    "x86_64-darwin": "x86_64-macos",
    "aarch64-darwin": "aarch64-macos",
}
SUFFIX = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
FLAGS = ["-std=c99", "-O2", "-shared", "-fPIC", "-ffp-contract=off", "-fno-math-errno"]
LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the same bytes today and tomorrow


def compiler(target: str) -> list[str]:
    """The system's C compiler for this platform, or that of the ziglang wheel, which is for
    every one of them.

    **Raises:** `OSError` without one."""
    names = ("cc", "gcc", "clang") if target == this_platform() else ()
    for name in names:
        found = shutil.which(name)
        if found:
            return [found]
    if importlib.util.find_spec("ziglang") is not None:
        # Without a target it takes what only the processor of this machine has.
        chosen = ["-target", TARGETS[target]] if target in TARGETS else []
        return [sys.executable, "-m", "ziglang", "cc", *chosen, "-s"]
    raise OSError(
        f"An FMU has a binary for {target} in it, but there is no C compiler for that: "
        f'{"install one, or " if names else ""}"pip install ziglang".'
    )


def this_platform() -> str:
    """The name of this platform in FMI 3."""
    system = {"win32": "windows"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    return f"{machine}-{system}"


def binary_of(target: str, version: int, prefix: str) -> str:
    """The place of the binary of a platform in an FMU."""
    machine, _, system = target.partition("-")
    folder = target
    if version == 2 and machine == "x86_64":
        folder = f"{ {'windows': 'win'}.get(system, system) }64"
    return f"binaries/{folder}/{prefix}{SUFFIX.get(system, '.so')}"


def check_platforms(platforms: Sequence[str]) -> tuple[str, ...]:
    """This platform and others, each once.

    **Raises:** `ValueError` for one that is not known."""
    for each in platforms:
        if each not in TARGETS:
            raise ValueError(
                f"Argument `platforms` must hold names of {', '.join(TARGETS)}, but got "
                f"{each!r}."
            )
    return tuple(dict.fromkeys([this_platform(), *platforms]))


def write_fmu(
    path: Path,
    version: int,
    files: Mapping[str, str],
    prefix: str,
    interval: float | None,
    fields: Mapping[str, Sequence[Field]],
    columns: Mapping[str, Sequence[str]],
    notes: Mapping[str, str],
    platforms: Sequence[str] = (),
) -> None:
    """Write an FMU of version 2 or 3 around the `files` of an export, whose `fields` are
    its `inputs`, `first`, `outputs` and `parameters`, with binaries for this platform and
    for further `platforms`."""
    given = [f for f in fields["inputs"] if f.name != "dt" or interval is not None]
    known = variables(given, fields["outputs"], fields["parameters"], columns, notes)
    code = f"{prefix}.c"
    digest = hashlib.sha256((files[code] + files[f"{prefix}.h"]).encode()).hexdigest()
    token = "{" + str(uuid.uuid5(uuid.NAMESPACE_OID, digest)) + "}"
    real = "double" if given[0].dtype.itemsize == 8 else "float"
    around = fmu_source(
        prefix, version, token, interval, real, fields["inputs"], fields["first"], known
    )
    sources = {name: files[name] for name in (f"{prefix}.h", code)}
    sources[f"{prefix}_fmi{version}.c"] = around
    describe = {2: _description2, 3: _description3}[version]
    inside: dict[str, bytes] = {
        "modelDescription.xml": describe(prefix, token, interval, known).encode(),
        "documentation/README.md": files["README.md"].encode(),
    }
    for target in check_platforms(platforms):
        inside[binary_of(target, version, prefix)] = _built(sources, target)
    inside |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    if version == 3:
        inside["sources/buildDescription.xml"] = _build(prefix, sources).encode()
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(inside.items()):
            info = zipfile.ZipInfo(name, LONG_AGO)
            info.external_attr = 0o644 << 16
            archive.writestr(info, content, zipfile.ZIP_DEFLATED)
    write_files(path.parent, {path.name: whole.getvalue()})


def _built(sources: Mapping[str, str], target: str) -> bytes:
    gone = lambda: discard(Path(folder))
    with tempfile.TemporaryDirectory() as folder, unfinished(gone):
        for name, text in sources.items():
            (Path(folder) / name).write_text(text)
        names = [name for name in sources if name.endswith(".c")]
        command = [*compiler(target), *FLAGS, "-o", "binary", *names]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise OSError(f"The C compiler failed: {done.stderr.strip()}")
        return (Path(folder) / "binary").read_bytes()


def _attributes(**given: object) -> str:
    return "".join(f" {k}={quoteattr(str(v))}" for k, v in given.items() if v is not None)


def _experiment(interval: float | None) -> str:
    return f"  <DefaultExperiment{_attributes(stepSize=interval or 1e-3)}/>"


def _variable(v: Variable, **more: object) -> str:
    """What both versions say of a variable."""
    return _attributes(
        name=v.name,
        valueReference=v.reference,
        description=v.about,
        causality=v.causality,
        variability="tunable" if v.causality == "parameter" else "discrete",
        **more,
    )


def _head(version: str, prefix: str, **more: object) -> list[str]:
    given = _attributes(
        fmiVersion=version,
        modelName=prefix,
        generationTool=f"aslo_jax {__version__}",
        variableNamingConvention="flat",
        **more,
    )
    return ['<?xml version="1.0" encoding="UTF-8"?>', f"<fmiModelDescription{given}>"]


def _description2(
    prefix: str, token: str, interval: float | None, known: Sequence[Variable]
) -> str:
    able = str(interval is None).lower()
    lines = _head("2.0", prefix, guid=token)
    lines += [
        f'  <CoSimulation modelIdentifier="{prefix}" canGetAndSetFMUstate="true" '
        f'canSerializeFMUstate="true" canHandleVariableCommunicationStepSize="{able}">',
        f'    <SourceFiles><File name="{prefix}.c"/><File name="{prefix}_fmi2.c"/>'
        "</SourceFiles>",
        "  </CoSimulation>",
        _experiment(interval),
        "  <ModelVariables>",
    ]
    for v in known:
        kind = "Boolean" if v.boolean else "Real"
        start = None if v.start is None else repr(v.start)
        value = f"<{kind}{_attributes(start=start)}/>"
        lines.append(f"    <ScalarVariable{_variable(v)}>{value}</ScalarVariable>")
    outputs = "".join(
        f'<Unknown index="{v.reference + 1}"/>' for v in known if v.causality == "output"
    )
    lines += [
        "  </ModelVariables>",
        f"  <ModelStructure><Outputs>{outputs}</Outputs>"
        f"<InitialUnknowns>{outputs}</InitialUnknowns></ModelStructure>",
        "</fmiModelDescription>",
        "",
    ]
    return "\n".join(lines)


def _description3(
    prefix: str, token: str, interval: float | None, known: Sequence[Variable]
) -> str:
    able = str(interval is None).lower()
    lines = _head("3.0", prefix, instantiationToken=token)
    lines += [
        f'  <CoSimulation modelIdentifier="{prefix}" canGetAndSetFMUState="true" '
        f'canSerializeFMUState="true" canHandleVariableCommunicationStepSize="{able}"/>',
        _experiment(interval),
        "  <ModelVariables>",
    ]
    for v in known:
        given = _variable(v, start=None if v.start is None else repr(v.start))
        lines.append(f"    <{'Boolean' if v.boolean else 'Float64'}{given}/>")
    time = _attributes(
        name="time",
        valueReference=len(known),
        causality="independent",
        variability="continuous",
    )
    lines += [f"    <Float64{time}/>", "  </ModelVariables>", "  <ModelStructure>"]
    for kind in ("Output", "InitialUnknown"):
        lines += [
            f'    <{kind} valueReference="{v.reference}"/>'
            for v in known
            if v.causality == "output"
        ]
    return "\n".join([*lines, "  </ModelStructure>", "</fmiModelDescription>", ""])


def _build(prefix: str, sources: Mapping[str, str]) -> str:
    names = [name for name in sources if name.endswith(".c")]
    files = "".join(f'<SourceFile name="{name}"/>' for name in names)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{prefix}"><SourceFileSet language="C99">'
        f"{files}</SourceFileSet></BuildConfiguration>\n</fmiBuildDescription>\n"
    )
