"""Exported C on a Cortex-M4F, and by the rules of MISRA C:2012 that cppcheck knows."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from exported_motor import export_motor

pytestmark = pytest.mark.slow

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
    "10.4": "counters of loops are unsigned, their bounds plain numbers",
    "10.8": "bits of a number are shifted as unsigned, and cast back",
    "12.1": "operands of ?: that are sums or names, which the addon wants in brackets",
    "15.5": "a rounding function returns at once what has no fraction",
    "19.2": "bits of a number are read through a union",
}
# What a violation of a rule looks like, as the body of a function of n.
PLANTED = {
    "7.1": "return n + 010;",
    "9.3": "int a[3] = {1, 2}; return a[n];",
    "12.3": "int a = n, b = n; return a + b;",
    "13.4": "int a; if ((a = n) > 1) { a = 2; } return a;",
    "14.4": "int a = n; if (a) { a = 2; } return a;",
    "15.1": "int a = n; if (a > 2) { goto out; } a = 3; out: return a;",
    "15.6": "int a = n; if (a > 2) a = 3; return a;",
    "15.7": "int a = n; if (a > 2) { a = 1; } else if (a > 1) { a = 0; } return a;",
    "16.4": "int a = n; switch (a) { case 1: a = 2; break; } return a;",
    "17.2": "return (n > 0) ? planted(n - 1) : 0;",
    "18.8": "int a[n]; a[0] = n; return a[0];",
    "19.2": "union { int i; float f; } a; a.i = n; return a.i;",
    "21.6": 'printf("%d", n); return n;',
}


def violated(folder: Path, name: str) -> set[str]:
    """The numbers of the rules that a file violates."""
    check = ["cppcheck", "--addon=misra", "--std=c99", "--enable=style", "--quiet"]
    done = subprocess.run([*check, name], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(re.findall(r"\[misra-c2012-(\d+\.\d+)\]", done.stderr))


@pytest.mark.parametrize("rule", PLANTED)
def test_a_planted_violation_is_found(rule, tmp_path):
    needs("cppcheck")
    head = "int planted(int n);\n"
    included = "#include <stdio.h>\n" if "printf" in PLANTED[rule] else ""
    (tmp_path / "one.c").write_text(
        f"{included}{head}int planted(int n) {{ {PLANTED[rule]} }}\n"
    )
    (tmp_path / "none.c").write_text(f"{head}int planted(int n) {{ return n; }}\n")
    assert rule in violated(tmp_path, "one.c")
    assert rule not in violated(tmp_path, "none.c")


def test_the_rules_of_misra_but_for_the_deviations(tmp_path):
    needs("cppcheck")
    export_motor().write(tmp_path)
    assert violated(tmp_path, "motor.c") <= set(DEVIATIONS)
