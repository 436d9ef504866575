"""Exported C on a Cortex-M4F, and by the rules of MISRA C:2012 that cppcheck knows."""

import re
import shutil
import subprocess

import pytest
from exported_modules import controller, restrained, thirty
from exported_motor import ROOT, export_motor
from misra_planted import planted, violated

# The vectors of a processor without an operating system: a stack, and where to begin, with
# its floating-point unit on. Newlib does the rest, and talks to the emulator.
BOOT = """
extern void _mainCRTStartup(void);
void reset(void);
__attribute__((section(".vectors"), used)) void *const vectors[2] = {
    (void *)0x20010000u, (void *)reset};
void reset(void)
{
    *(volatile unsigned *)0xE000ED88u |= 0xFu << 20;
    __asm volatile("dsb\\n isb");
    _mainCRTStartup();
}
"""
MEMORY = """
MEMORY {
  FLASH (rx) : ORIGIN = 0, LENGTH = 1M
  RAM (rwx) : ORIGIN = 0x20000000, LENGTH = 64K
}
ENTRY(reset)
SECTIONS {
  .text : {
    KEEP(*(.vectors)) *(.text*) *(.rodata*) KEEP(*(.init)) KEEP(*(.fini)) *(.eh_frame*)
    . = ALIGN(8);
  } > FLASH
  .ARM.exidx : { *(.ARM.exidx*) } > FLASH
  .data : { *(.data*) . = ALIGN(8); } > RAM
  .bss : { __bss_start__ = .; *(.bss*) *(COMMON) . = ALIGN(8); __bss_end__ = .; } > RAM
  end = .; __end__ = .;
}
"""
TARGET = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
EMULATOR = [
    *("qemu-system-arm", "-M", "mps2-an386", "-cpu", "cortex-m4", "-nographic"),
    *("-semihosting-config", "enable=on,target=native", "-kernel"),
]


def needs(*programs: str) -> None:
    absent = [name for name in programs if shutil.which(name) is None]
    if absent:
        pytest.skip(f"not installed: {', '.join(absent)}")


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_vectors_on_a_cortex_m4f(dtype, tmp_path):
    needs("arm-none-eabi-gcc", "qemu-system-arm")
    export_motor(dtype=dtype).write(tmp_path)
    (tmp_path / "boot.c").write_text(BOOT)
    (tmp_path / "m4.ld").write_text(MEMORY)
    build = ["arm-none-eabi-gcc", "-std=c99", "-O2", *TARGET, "--specs=rdimon.specs"]
    sources = ["-T", "m4.ld", "-o", "m4.elf", "boot.c", "main.c", "motor.c"]
    done = subprocess.run([*build, *sources], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

    def run() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*EMULATOR, "m4.elf"], cwd=tmp_path, capture_output=True, text=True, timeout=120
        )

    done = run()
    assert done.returncode == 0, done.stdout + done.stderr
    off = float(re.search(r"largest error (\S+) of the signal in 64 rows", done.stdout)[1])
    assert off < {"float32": 1e-3, "float64": 1e-12}[dtype]
    text = (tmp_path / "main.c").read_text()
    (tmp_path / "main.c").write_text(
        text.replace("#define TOLERANCE ", "#define TOLERANCE -")
    )
    subprocess.run([*build, *sources], cwd=tmp_path, capture_output=True, check=True)
    assert run().returncode == 1


# Rules that the C deviates from, and why.
DEVIATIONS = {
    "2.5": "a macro of the header is for its user, the interval",
    "10.8": "bits of a number are shifted as unsigned, and cast back",
    "12.1": "operands of ?: that are sums or names, which the addon wants in brackets",
    "15.5": "a rounding function returns at once what has no fraction",
    "19.2": "bits of a number are read through a union",
}


@pytest.mark.slow
def test_every_planted_violation_is_found(tmp_path):
    """And none where there is none."""
    needs("cppcheck")
    files = {}
    for rule, texts in planted().items():
        for k, text in enumerate(texts):
            name = f"r{rule.replace('.', '_')}_{k}.c"
            files[name] = rule
            (tmp_path / name).write_text(text)
    (tmp_path / "none.c").write_text("int none(int n);\nint none(int n) { return n; }\n")
    found = violated(tmp_path, [*files, "none.c"])
    seen = {files[name] for name in files if files[name] in found[name]}
    assert set(planted()) - seen == set()
    assert found["none.c"] <= {"8.7"}  # nobody else uses it


def test_the_page_lists_the_rules_that_are_checked():
    text = (ROOT / "docs" / "firmware.md").read_text("utf-8")
    section = text.partition("## MISRA C:2012")[2].partition("\n## ")[0]
    checked, deviations = re.split(r"\n\| rule ", section)
    head, _, listed = checked.partition(f"Checked are the {len(planted())} rules")
    assert f"{len(planted())} of its rules, each" in head
    assert set(re.findall(r"\b\d+\.\d+\b", listed)) == set(planted())
    assert set(re.findall(r"^\| (\d+\.\d+) \|", deviations, re.MULTILINE)) == set(
        DEVIATIONS
    )


EXPORTS = {
    "motor": export_motor,
    "fixed": lambda: export_motor(dtype="float32", fixed=("all",)),
    "thirty": thirty,
    "full": restrained,
    "controller": controller,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPORTS)
def test_the_rules_of_misra_but_for_the_deviations(name, tmp_path):
    needs("cppcheck")
    exported = EXPORTS[name]()
    exported.write(tmp_path)
    file = f"{exported.prefix}.c"
    assert violated(tmp_path, [file])[file] <= set(DEVIATIONS)
