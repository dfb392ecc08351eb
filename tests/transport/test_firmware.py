"""The generated C, compiled as strictly as it can be, against Python: 100,000 frames each way, and as many bad ones."""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache

import pytest

from transport.firmware import header, source, write
from transport.framing import Deframer, wrap
from transport.mcu_frames import (
    LAYOUTS,
    MAX_BEAMS,
    MAX_CONTENT,
    REASONS,
    Field,
    Frame,
    FrameError,
    Layout,
    decode,
    encode,
    limits,
)

COUNT = 100_000
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-pedantic", "-O2"]
SANITIZED = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

DRIVER = """
#include "orion_frames.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t state = 88172645463325252u; /* xorshift64, Marsaglia 2003 */

static uint64_t some(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state >> 11;
}

static void print_wire(const uint8_t *wire, int length)
{
    for (int n = 0; n < length; n++)
        printf("%02x", wire[n]);
}

/* Encodes twice: into a buffer that is long enough, and into one that ends a byte too early. */
#define ENCODE(name, frame)                                                        \\
    do {                                                                           \\
        uint8_t wire[ORION_MAX_FRAME];                                             \\
        int length = orion_encode_##name(frame, wire, sizeof wire);                \\
        uint8_t *tight = length > 0 ? malloc((size_t)length - 1) : NULL;           \\
        if (tight == NULL || orion_encode_##name(frame, tight, (size_t)length - 1) != ORION_NO_ROOM) \\
            abort();                                                               \\
        free(tight);                                                               \\
        print_wire(wire, length);                                                  \\
    } while (0)

@FUNCTIONS@

static void encode_all(long count)
{
    for (long n = 0; n < count; n++) {
        switch (some() % @KINDS@) {
@RANDOM_CASES@
        }
        putchar('\\n');
    }
}

static void decode_all(void)
{
    struct orion_feeder feeder;
    struct orion_frame frame, untouched;
    int byte, kind;
    orion_feeder_start(&feeder);
    memset(&untouched, 0x5A, sizeof untouched);
    while ((byte = getchar()) != EOF) {
        memset(&frame, 0x5A, sizeof frame);
        kind = orion_feed(&feeder, (uint8_t)byte, &frame);
        if (kind <= 0 && memcmp(&frame, &untouched, sizeof frame) != 0)
            abort();
        switch (kind) {
        case 0:
            break;
@ECHO_CASES@
        default:
            printf("%d\\n", kind);
        }
    }
    printf("good %lu damaged %lu\\n", (unsigned long)feeder.good, (unsigned long)feeder.damaged);
}

int main(int argc, char **argv)
{
    if (argc == 2)
        encode_all(atol(argv[1]));
    else
        decode_all();
    return 0;
}
"""


def print_of(fields: tuple[Field, ...], row: str) -> str:
    return "".join(
        f'    printf(" %llu", (unsigned long long)({row}{field.name}));\n'
        if field.c_type.startswith("u")
        else f'    printf(" %lld", (long long)({row}{field.name}));\n'
        for field in fields
    )


def random_of(fields: tuple[Field, ...], row: str) -> str:
    lines = ""
    for field in fields:
        least, largest = limits(field)
        suffix = "u" if least >= 0 else ""
        any_value = f"({field.c_type})({least} + (long long)(some() % {largest - least + 1}u))"
        if largest >= 2**63:
            any_value = f"({field.c_type})(some() * 2049u)"
        lines += f"    {row}{field.name} = ({field.c_type})(some() % 8 ? {any_value} : {largest}{suffix});\n"
    return lines


def functions_of(layout: Layout) -> str:
    name, group = layout.name, layout.group
    prints, randoms = print_of(layout.fields, "frame->"), random_of(layout.fields, "frame->")
    if group:
        prints += f"""\
    printf(" %d", frame->count);
    for (int n = 0; n < frame->count; n++) {{
    {print_of(group.fields, f"frame->{group.name}[n].")}    }}
"""
        randoms += f"""\
    frame->count = (uint8_t)(some() % 8 ? some() % 6 : some() % (ORION_MAX_BEAMS + 1));
    for (int n = 0; n < frame->count; n++) {{
    {random_of(group.fields, f"frame->{group.name}[n].")}    }}
"""
    return f"""
static void print_{name}(const struct orion_{name} *frame)
{{
    ENCODE({name}, frame);
    printf(" {layout.kind}");
{prints}}}

static void random_{name}(void)
{{
    struct orion_{name} any, *frame = &any;
{randoms}    print_{name}(frame);
}}
"""


def driver() -> str:
    kinds = [layout.name for layout in LAYOUTS.values()]
    echo = "".join(
        f"        case ORION_{kind.upper()}:\n            print_{kind}(&frame.as.{kind});\n"
        "            putchar('\\n');\n            break;\n"
        for kind in kinds
    )
    cases = "".join(
        f"        case {n}:\n            random_{kind}();\n            break;\n" for n, kind in enumerate(kinds)
    )
    return (
        DRIVER.replace("@FUNCTIONS@", "".join(map(functions_of, LAYOUTS.values())))
        .replace("@RANDOM_CASES@", cases)
        .replace("@ECHO_CASES@", echo)
        .replace("@KINDS@", str(len(kinds)))
    )


Run = Callable[..., list[str]]


@pytest.fixture(scope="module")
def gcc() -> str:
    found = shutil.which("gcc")
    if found is None:
        pytest.fail("gcc is missing: the microcontroller's code cannot be checked (apt-get install gcc libc6-dev)")
    return found


@pytest.fixture(scope="module")
def run(gcc: str, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs the driver around the generated code, with the given input; its lines."""
    folder = tmp_path_factory.mktemp("firmware")
    write(folder)
    (folder / "driver.c").write_text(driver())
    built = folder / "driver"
    sources = [folder / "driver.c", folder / "orion_frames.c"]
    subprocess.run([gcc, *STRICT, "-Wno-conversion", *SANITIZED, *sources, "-o", built], check=True)

    def run(*arguments: str, stdin: bytes = b"") -> list[str]:
        done = subprocess.run([built, *arguments], input=stdin, capture_output=True, check=False, timeout=300)
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.decode().splitlines()

    return run


def values_of(frame: Frame) -> list[int]:
    """The frame as the driver prints it: kind, fields, count, items."""
    layout = LAYOUTS[type(frame)]
    values = [layout.kind, *(int(getattr(frame, field.name)) for field in layout.fields)]
    if layout.group:
        items = getattr(frame, layout.group.name)
        values += [len(items), *(value for item in items for value in item)]
    return values


def line_of(frame: Frame) -> str:
    return " ".join([wrap(encode(frame)).hex(), *map(str, values_of(frame))])


@cache
def spans(fields: tuple[Field, ...]) -> list[tuple[int, int]]:
    return [(least, largest - least + 1) for least, largest in map(limits, fields)]


def random_row(fields: tuple[Field, ...], some: random.Random) -> list[int]:
    """Values within their limits; one in eight is the least or the largest."""
    bits = some.getrandbits(64 * len(fields))
    row = []
    for least, span in spans(fields):
        at = bits >> 4 & 2**59 - 1
        row.append(least + ((0, span - 1)[bits & 1] if bits & 14 == 0 else at * span >> 59))
        bits >>= 64
    return row


def random_frame(some: random.Random) -> Frame:
    frame_type = some.choice(list(LAYOUTS))
    layout = LAYOUTS[frame_type]
    values = random_row(layout.fields, some)
    if layout.group is None:
        return frame_type(*values)
    count = some.randint(0, MAX_BEAMS) if some.random() < 0.1 else some.randint(0, 5)
    return frame_type(*values, tuple(layout.group.item(*random_row(layout.group.fields, some)) for _ in range(count)))


def assert_same(got: list[str], expected: list[str]) -> None:
    """As ``got == expected``, without a diff of 100,000 lines."""
    assert next((pair for pair in zip(got, expected, strict=False) if pair[0] != pair[1]), None) is None
    assert len(got) == len(expected)


def test_the_same_table_gives_the_same_text(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    for folder, seed in ((first, "0"), (second, "1")):
        subprocess.run(
            [sys.executable, "-m", "transport.firmware", folder],
            check=True,
            capture_output=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        )
    for name, text in (("orion_frames.h", header()), ("orion_frames.c", source())):
        assert (first / name).read_bytes() == (second / name).read_bytes() == text.encode()


def test_it_compiles_without_a_warning_on_its_own(gcc, tmp_path):
    _, code = write(tmp_path)
    for optimised in ("-O0", "-Os", "-O2"):
        subprocess.run([gcc, *STRICT, optimised, "-c", code, "-o", tmp_path / "orion_frames.o"], check=True)


def test_the_header_says_units_and_limits():
    text = header()
    assert "int16_t left_mm_s; /* left wheel's speed [mm/s] */" in text
    assert "uint8_t heading_valid; /* 1 if the heading can be trusted; 0 to 1 */" in text
    assert f"#define ORION_MAX_CONTENT {MAX_CONTENT}\n" in text


def test_nothing_is_allocated_packed_or_kept(gcc, tmp_path):
    _, code = write(tmp_path)
    assert not re.search("malloc|packed|__attribute__", code.read_text())
    subprocess.run([gcc, *STRICT, "-c", code, "-o", tmp_path / "orion_frames.o"], check=True)
    symbols = subprocess.run(["nm", tmp_path / "orion_frames.o"], check=True, capture_output=True, text=True).stdout
    kinds = {line.split()[-2] for line in symbols.splitlines()}
    assert kinds <= {"T", "t", "U", "r", "R"}  # code, calls to elsewhere, constants: no variables


def test_what_c_encodes_python_decodes(run):
    lines = run(str(COUNT))
    assert len(lines) == COUNT
    deframer = Deframer(max_content=MAX_CONTENT)
    for line in lines:
        wire = bytes.fromhex(line.partition(" ")[0])
        (content,) = deframer.feed(wire)
        assert line_of(decode(content)) == line


def test_what_python_encodes_c_decodes_and_encodes_alike(run):
    some = random.Random(5)
    frames = [random_frame(some) for _ in range(COUNT)]
    *lines, counts = run(stdin=b"".join(wrap(encode(frame)) for frame in frames))
    assert_same(lines, [line_of(frame) for frame in frames])
    assert counts == f"good {COUNT} damaged 0"


def mangled(content: bytes, some: random.Random) -> bytes:
    """A frame that went wrong: on the line, or already at the one who said it."""
    wrong = bytearray(content)
    for _ in range(some.randint(1, 2)):
        wrong[some.randrange(min(len(wrong), some.choice([2, 30, len(wrong)])))] = some.randrange(256)
    match some.randrange(6):
        case 0:
            return wrap(bytes(wrong))
        case 1:
            return wrap(bytes(wrong) + some.randbytes(some.choice([1, 3, 300])))
        case 2:
            return wrap(content[: some.randrange(len(content))])
        case 3:
            wire = bytearray(wrap(content))
            wire[some.randrange(len(wire))] ^= some.randrange(1, 256)
            return bytes(wire)
        case 4:
            wire = bytearray(wrap(content))
            del wire[some.randrange(len(wire))]
            return bytes(wire)
        case _:
            return some.randbytes(some.randrange(40)) + wrap(content)


def pythons_lines(stream: bytes) -> list[str]:
    """What the driver should say of a stream."""
    deframer = Deframer(max_content=MAX_CONTENT)
    errors = {reason: str(-2 - n) for n, reason in enumerate(REASONS)}
    lines = []
    for piece in stream.split(b"\0")[:-1]:
        damaged = deframer.counters["damaged"]
        contents = deframer.feed(piece + b"\0")
        lines += ["-1"] * (deframer.counters["damaged"] - damaged)
        for content in contents:
            try:
                lines.append(line_of(decode(content)))
            except FrameError as error:
                lines.append(errors[error.reason])
    return [*lines, f"good {deframer.counters['good']} damaged {deframer.counters['damaged']}"]


def test_what_is_wrong_is_refused_by_both_for_the_same_reason(run):
    some = random.Random(6)
    stream = b"".join(mangled(encode(random_frame(some)), some) for _ in range(COUNT)) + b"\0"
    expected = pythons_lines(stream)
    assert_same(run(stdin=stream), expected)
    reasons = {line for line in expected if line.startswith("-")}
    assert reasons == {str(-1 - n) for n in range(1 + len(REASONS))}


def test_c_refuses_to_encode_what_python_refuses(gcc, tmp_path):
    """One value out of its limits at a time, and one beam too many."""
    tries = []
    for layout in LAYOUTS.values():
        good = "".join(f"frame.{field.name} = ({field.c_type}){limits(field)[0]}; " for field in layout.fields)
        begin = f"{{ struct orion_{layout.name} frame; memset(&frame, 0, sizeof frame); {good}"
        end = f" EXPECT(orion_encode_{layout.name}(&frame, wire, sizeof wire) == %s); }}\n"
        tries.append(begin + end.replace("== %s", "> 0"))
        for field in layout.fields:
            tries += [f"{begin}frame.{field.name} = 0;{end % 'ORION_BAD_VALUE'}"] * (field.least == 1)
            tries += [
                f"{begin}frame.{field.name} = {value + 1};{end % 'ORION_BAD_VALUE'}"
                for value in [field.largest]
                if value is not None
            ]
        if layout.group:
            tries.append(f"{begin}frame.count = {MAX_BEAMS + 1};{end % 'ORION_BAD_COUNT'}")
    write(tmp_path)
    (tmp_path / "refuse.c").write_text(
        '#include "orion_frames.h"\n#include <stdlib.h>\n#include <string.h>\n'
        "#define EXPECT(truth) do { if (!(truth)) abort(); } while (0)\n"
        f"int main(void)\n{{\nuint8_t wire[ORION_MAX_FRAME];\n{''.join(tries)}return 0;\n}}\n"
    )
    sources = [tmp_path / "refuse.c", tmp_path / "orion_frames.c"]
    subprocess.run([gcc, *STRICT, "-Wno-shadow", *SANITIZED, *sources, "-o", tmp_path / "refuse"], check=True)
    subprocess.run([tmp_path / "refuse"], check=True)
    assert len(tries) > 10
