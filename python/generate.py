#!/usr/bin/env python3
"""Writes src/sinew_arm/payloads.py from src/ipc/PAYLOADS.md, which a test of the daemon keeps equal to its own types.

python3 python/generate.py            writes it
python3 python/generate.py --check    fails where it is not what would be written
"""

from __future__ import annotations

import re
import sys
import textwrap
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parent / "src" / "ipc" / "PAYLOADS.md"
OUTPUT = HERE / "src" / "sinew_arm" / "payloads.py"
HEADER = HERE.parent / "include" / "sinew_payloads.h"
WIDTH = 120

SCALARS = {
    "u8": ("c_uint8", "np.uint8", "int"),
    "u32": ("c_uint32", "np.uint32", "int"),
    "u64": ("c_uint64", "np.uint64", "int"),
    "f64": ("c_double", "np.float64", "float"),
}

# How many places of an array are in use, where a field tells: by the payload and the array's first dimension.
IN_USE = {
    ("Encoders", 96): "self.cable_count",
    ("Obstacles", 64): "self.count",
    ("Obstacles", 256): "self.vertex_count",
    ("Target", 32): "2 * self.segment_count",
    ("State", 96): "self.cable_count",
    ("State", 32): "2 * self.segment_count",
    ("State", 64): "self.node_count",
    ("State", 256): "self.distance_count",
}
# Thirty-two alarms, and thirty-two curvatures.
IN_USE_BY_NAME = {("State", "alarms"): "self.alarm_count"}


@dataclass
class Field:
    """A row of a payload's table."""

    offset: int
    size: int
    name: str
    type: str
    unit: str
    meaning: str


@dataclass
class Payload:
    """A table of fields."""

    name: str
    size: int
    fields: list[Field] = field(default_factory=list)


@dataclass
class Code:
    """A table of numbers and their names."""

    name: str
    meaning: str
    values: list[tuple[int, str, str]] = field(default_factory=list)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def read(text: str) -> tuple[int, list[Payload], list[Code]]:
    """The schema version, payloads in the order of the page, and codes."""
    stated = re.search(r"^Schema version (\d+)\.", text, re.MULTILINE)
    if stated is None:
        raise ValueError(f"{SOURCE}: no schema version")
    version = int(stated.group(1))
    before, after = text.split("\n## Codes\n")
    payloads: list[Payload] = []
    for part in before.split("\n## Payloads\n")[1].split("\n### ")[1:]:
        name = part.split("\n", 1)[0].strip()
        head = re.search(r"^Type name `sinew\.(\w+)\.v(\d+)`, (\d+) bytes", part, re.MULTILINE)
        if head is None or head.group(1) != name or int(head.group(2)) != version:
            raise ValueError(f"{name}: no type name of version {version}")
        payload = Payload(name, int(head.group(3)))
        for line in part.splitlines():
            if re.match(r"\| \d+ \|", line):
                offset, size, field_name, kind, unit, meaning = cells(line)
                row = Field(int(offset), int(size), field_name.strip("`"), kind.strip("`"), unit, meaning)
                payload.fields.append(row)
        payloads.append(payload)
    codes: list[Code] = []
    for part in after.split("\n### ")[1:]:
        name, rest = part.split("\n", 1)
        code = Code(name.strip(), " ".join(rest.split("\n| number |")[0].split()))
        for line in rest.splitlines():
            if re.match(r"\| \d+ \|", line):
                number, variant, meaning = cells(line)
                code.values.append((int(number), variant, meaning))
        codes.append(code)
    return version, payloads, codes


def constant(name: str) -> str:
    """`EmergencyStop` as `EMERGENCY_STOP`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).upper()


def dimensions(kind: str) -> tuple[str, list[int]]:
    """`f64[64][3]` as `f64` and [64, 3]."""
    return kind.split("[", maxsplit=1)[0], [int(n) for n in re.findall(r"\[(\d+)\]", kind)]


def plain(meaning: str) -> str:
    """A meaning without the page's links to Rust."""
    return meaning.replace("::", ".")


def doc(text: str, indent: str) -> list[str]:
    """A docstring, on one line where it fits."""
    one = f'{indent}"""{text}"""'
    if len(one) <= WIDTH:
        return [one]
    lines = textwrap.wrap(text, WIDTH - len(indent) - 3)
    return [f'{indent}"""{lines[0]}', *(indent + line for line in lines[1:]), f'{indent}"""']


def code_of(row: Field, codes: list[Code]) -> Code | None:
    """The code that a number stands for: its meaning begins with the code's name."""
    match = re.match(r"`(\w+)`", row.meaning)
    found = next((code for code in codes if match and code.name == match.group(1)), None)
    return found if row.type == "u32" else None


def with_unit(row: Field, code: Code | None) -> str:
    """The meaning, that of its code where it is but named, and the unit where the words have none."""
    if code is not None and row.meaning == f"`{code.name}`.":
        return plain(code.meaning)
    missing = row.unit != "-" and f"({row.unit})" not in row.meaning and row.unit not in row.meaning
    return plain(row.meaning) + (f" Unit: {row.unit}." if missing else "")


def accessor(name: str, annotation: str, text: str, get: str, put: str, value: str) -> list[str]:
    """A property with its setter."""
    return [
        "    @property",
        f"    def {name}(self) -> {annotation}:",
        *doc(text, " " * 8),
        f"        return {get}",
        "",
        f"    @{name}.setter",
        f"    def {name}(self, value: {value}) -> None:",
        f"        {put}",
        "",
    ]


def members(payload: Payload, codes: list[Code]) -> list[str]:
    """Annotations of what ctypes reads as it is, then properties of the rest."""
    plain_lines: list[str] = []
    properties: list[str] = []
    for row in payload.fields:
        base, shape = dimensions(row.type)
        code = code_of(row, codes)
        text = with_unit(row, code)
        if not shape and code is not None:
            optional = "without" in row.meaning and all(number != 0 for number, _, _ in code.values)
            annotation = f"{code.name} | None" if optional else code.name
            get = f"{code.name}(self._{row.name})"
            get = f"{get} if self._{row.name} else None" if optional else get
            put = f"self._{row.name} = int(value)" if not optional else f"self._{row.name} = int(value or 0)"
            value = "int | None" if optional else "int"
            properties += accessor(row.name, annotation, text, get, put, value)
        elif not shape:
            annotation = SCALARS[base][2] if base in SCALARS else base
            plain_lines += [f"    {row.name}: {annotation}", *doc(text, "    ")]
        elif base == "u8":
            put = f"self._set_text({row.name!r}, value)"
            properties += accessor(row.name, "str", text, f"self._get_text({row.name!r})", put, "str")
        elif base not in SCALARS:
            used = IN_USE_BY_NAME.get((payload.name, row.name)) or IN_USE.get((payload.name, shape[0]))
            get = f"self._list(self._{row.name}, {used or shape[0]})"
            properties += [
                "    @property",
                f"    def {row.name}(self) -> list[{base}]:",
                *doc(text + (" Those in use, to be changed in place." if used else ""), " " * 8),
                f"        return {get}",
                "",
            ]
        elif row.name.endswith("_valid"):
            bits = 64 * shape[0]
            used = IN_USE[(payload.name, 96)]
            get = f"self._bits({row.name!r}, {bits})[: {used}]"
            text = f"{text} Shape (cables,)."
            put = f"self._set_bits({row.name!r}, {bits}, value)"
            properties += accessor(row.name, "BoolArray", text, get, put, "npt.ArrayLike")
        else:
            used = IN_USE.get((payload.name, shape[0])) if shape[0] > 16 else None
            whole = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
            get = f"self._array({row.name!r}, {SCALARS[base][1]}, ({whole}))"
            words = {"self.": "", "2 * ": "2 "}
            shown = whole.strip(",")
            if used:
                get += f"[: {used}]"
                count = used
                for old, new in words.items():
                    count = count.replace(old, new)
                shown = ", ".join([count, *map(str, shape[1:])])
            text = f"{text} Shape ({shown}{',' if len(shape) == 1 else ''})."
            annotation = "FloatArray" if base == "f64" else "IntArray"
            put = f"self._put({row.name!r}, {SCALARS[base][1]}, ({whole}), value)"
            properties += accessor(row.name, annotation, text, get, put, "npt.ArrayLike")
    return [*plain_lines, "", *properties]


def ctype(row: Field) -> str:
    base, shape = dimensions(row.type)
    name = f"ctypes.{SCALARS[base][0]}" if base in SCALARS else base
    for n in reversed(shape):
        name += f" * {n}"
    return name


def snake(name: str) -> str:
    """`ObstacleDistance` as `obstacle_distance`."""
    return constant(name).lower()


def comment(text: str, indent: str) -> list[str]:
    """A comment of C before what it is about."""
    lines = textwrap.wrap(plain(text), WIDTH - len(indent) - 6)
    return [f"{indent}/* {lines[0]}", *(f"{indent} * {line}" for line in lines[1:])]


def c_lines(text: str, indent: str) -> list[str]:
    lines = comment(text, indent)
    return [*lines[:-1], f"{lines[-1]} */"]


def write_header(version: int, payloads: list[Payload], codes: list[Code]) -> str:
    """The header of C."""
    kinds = {"u8": "uint8_t", "u32": "uint32_t", "u64": "uint64_t", "f64": "double"}
    out = [
        "/* What lies in shared memory: payloads and codes.",
        " *",
        " * Made by `python/generate.py` from `src/ipc/PAYLOADS.md`; not to be edited. For C11 and C++11, little-endian.",
        " * A field that stands for a code is a plain number, since anybody can write any.",
        " */",
        "#ifndef SINEW_PAYLOADS_H",
        "#define SINEW_PAYLOADS_H",
        "",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        "#define SINEW_ASSERT(what) static_assert(what, #what)",
        "#else",
        "#define SINEW_ASSERT(what) _Static_assert(what, #what)",
        "#endif",
        "",
        "/* Version of all payloads. */",
        f"#define SINEW_SCHEMA_VERSION {version}u",
        "/* `tick` in a header of what belongs to no tick. */",
        "#define SINEW_NO_TICK UINT64_MAX",
        "/* `flags` of `sinew_obstacles`: the source ends in order. */",
        "#define SINEW_FLAG_LEAVING 1u",
    ]
    for code in codes:
        out += ["", *c_lines(code.meaning, ""), "enum {"]
        for number, variant, meaning in code.values:
            out += c_lines(meaning, "    ")
            out.append(f"    SINEW_{constant(code.name)}_{constant(variant)} = {number},")
        out[-1] = out[-1].rstrip(",")
        out.append("};")
    for payload in payloads:
        name = f"struct sinew_{snake(payload.name)}"
        out += ["", f'#define SINEW_{constant(payload.name)}_TYPE_NAME "sinew.{payload.name}.v{version}"', f"{name} {{"]
        for row in payload.fields:
            base, shape = dimensions(row.type)
            kind = kinds.get(base) or f"struct sinew_{snake(base)}"
            out += c_lines(with_unit(row, None), "    ")
            out.append(f"    {kind} {row.name}{''.join(f'[{n}]' for n in shape)};")
        out += ["};", f"SINEW_ASSERT(sizeof({name}) == {payload.size});"]
        out += [f"SINEW_ASSERT(offsetof({name}, {row.name}) == {row.offset});" for row in payload.fields]
    return "\n".join([*out, "", "#endif", ""])


def write_module(version: int, payloads: list[Payload], codes: list[Code]) -> str:
    """The module of Python."""
    out = [
        '"""What lies in shared memory: payloads and codes.',
        "",
        "Made by `python/generate.py` from `src/ipc/PAYLOADS.md`; not to be edited. Arrays are views of the payload,",
        "cut to what is in use; assigning to one fills the places behind with zeros.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
        "import ctypes",
        "from typing import ClassVar",
        "",
        "import numpy as np",
        "import numpy.typing as npt",
        "",
        "from ._payload import BoolArray, Code, FloatArray, IntArray, Payload",
        "",
        f"SCHEMA_VERSION = {version}",
        '"""Version of all payloads."""',
        "NO_TICK = 2**64 - 1",
        '"""`Header.tick` of what belongs to no tick."""',
        "FLAG_LEAVING = 1",
        '"""`Obstacles.flags`: the source ends in order."""',
    ]
    for code in codes:
        out += ["", "", f"class {code.name}(Code):", *doc(plain(code.meaning), "    "), ""]
        for number, variant, meaning in code.values:
            out += [f"    {constant(variant)} = {number}", *doc(plain(meaning), "    ")]
    for payload in payloads:
        out += ["", "", f"class {payload.name}(Payload):"]
        out += doc(f"Payload of {payload.size} bytes.", "    ")
        fields = ", ".join(f'"{row.name}"' for row in payload.fields)
        listed = textwrap.wrap(fields + ("," if len(payload.fields) == 1 else ""), WIDTH - 8)
        out += ["", "    FIELDS: ClassVar[tuple[str, ...]] = ("]
        out += [f"        {line}" for line in listed]
        out += ["    )", "    _fields_: ClassVar = ["]
        for row in payload.fields:
            _, shape = dimensions(row.type)
            hidden = "_" if shape or code_of(row, codes) else ""
            out.append(f'        ("{hidden}{row.name}", {ctype(row)}),')
        out += ["    ]", "", *members(payload, codes)]
        out += [
            "    @staticmethod",
            "    def type_name() -> str:",
            '        """Name by which shared memory knows the type."""',
            f'        return "sinew.{payload.name}.v{version}"',
        ]
    out += ["", "", "# What the page says of every payload: its size, and where its fields begin."]
    out += ["LAYOUT: dict[type[Payload], tuple[int, tuple[int, ...]]] = {"]
    for payload in payloads:
        offsets = ", ".join(str(row.offset) for row in payload.fields)
        lines = textwrap.wrap(offsets + ("," if len(payload.fields) == 1 else ""), WIDTH - 12)
        out += [f"    {payload.name}: (", f"        {payload.size},", "        ("]
        out += [f"            {line}" for line in lines]
        out += ["        ),", "    ),"]
    out += ["}", ""]
    return re.sub(r"\n{4,}", "\n\n\n", "\n".join(line.rstrip() for line in out))


def main() -> int:
    """Writes, or checks."""
    read_page = read(SOURCE.read_text(encoding="utf-8"))
    stale = 0
    for output, wanted in ((OUTPUT, write_module(*read_page)), (HEADER, write_header(*read_page))):
        if "--check" not in sys.argv[1:]:
            output.parent.mkdir(exist_ok=True)
            output.write_text(wanted, encoding="utf-8")
        elif not output.is_file() or output.read_text(encoding="utf-8") != wanted:
            print(f"{output} is not what {SOURCE.name} says: run python/generate.py", file=sys.stderr)
            stale = 1
    return stale


if __name__ == "__main__":
    sys.exit(main())
