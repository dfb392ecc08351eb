"""The microcontroller's half of the protocol, as portable C99, generated from the table of its frames.

``python -m transport.firmware DIR`` writes ``orion_frames.h`` and ``orion_frames.c``. The same table gives the same
text, so there is nothing to keep in step by hand and nothing to commit.

Laws kept by the C: no allocation, no static state, no packed structs, no unaligned access, any byte order; a frame is
decoded whole or its target is left alone; what Python refuses is refused, for the same reason.
"""

from __future__ import annotations

import sys
from pathlib import Path

from transport.framing import longest_frame
from transport.mcu_frames import (
    LAYOUTS,
    MAX_BEAMS,
    MAX_CONTENT,
    RANGE_INVALID,
    RANGE_NOTHING,
    RANGE_VALID,
    REASONS,
    VERSION,
    Field,
    Group,
    Layout,
    bits,
    c_range,
    limits,
)

_UNITS = {"_mm_s": "mm/s", "_mm": "mm", "_um": "um", "_ms": "ms", "_turn16": "1/65536 turn"}
"""What the end of a field's name says of its unit; the longer endings first."""

_GROUPS = {layout.group.name: layout.group for layout in LAYOUTS.values() if layout.group}
_ROWS = [layout.fields for layout in LAYOUTS.values()] + [group.fields for group in _GROUPS.values()]
_WIDEST = max(bits(field.c_type) for row in _ROWS for field in row)
_WIDTHS = [width for width in (8, 16, 32, 64) if width <= _WIDEST]
_SIGNED_WIDTHS = sorted({bits(field.c_type) for row in _ROWS for field in row if not field.c_type.startswith("u")})


def header() -> str:
    """The text of ``orion_frames.h``."""
    kinds = "\n".join(f"#define ORION_{layout.name.upper()} {layout.kind}" for layout in LAYOUTS.values())
    reasons = "\n".join(f"#define ORION_BAD_{reason.upper()} (-{2 + n})" for n, reason in enumerate(REASONS))
    structs = "\n".join([*map(_group_struct, _GROUPS.values()), *map(_frame_struct, LAYOUTS.values())])
    members = "\n".join(f"        struct orion_{layout.name} {layout.name};" for layout in LAYOUTS.values())
    encoders = "\n".join(f"{_encoder_head(layout)};" for layout in LAYOUTS.values())
    return f"""\
{_GENERATED}
#ifndef ORION_FRAMES_H
#define ORION_FRAMES_H

#include <stddef.h>
#include <stdint.h>

#define ORION_VERSION {VERSION}
#define ORION_MAX_BEAMS {MAX_BEAMS}
#define ORION_MAX_CONTENT {MAX_CONTENT}
/* The longest frame on the line: content, checksum, COBS, delimiter. */
#define ORION_MAX_FRAME {longest_frame(MAX_CONTENT)}

/* Kinds of frames. */
{kinds}

/* A range's status: what the reading is worth. */
#define ORION_RANGE_VALID {RANGE_VALID}
#define ORION_RANGE_NOTHING {RANGE_NOTHING} /* nothing within the sensor's range */
#define ORION_RANGE_INVALID {RANGE_INVALID} /* the sensor does not trust it; it says nothing */

/* Errors. Damaged: bad COBS, a wrong checksum, too long. The others passed the checksum. */
#define ORION_DAMAGED (-1)
{reasons}
/* The caller's buffer is too short to encode into. */
#define ORION_NO_ROOM (-{2 + len(REASONS)})

{structs}
struct orion_frame {{
    uint8_t kind;
    union {{
{members}
    }} as;
}};

/*
 * Write the frame, as it goes over the line with its delimiter, to `out`, which has room for that many bytes
 * (ORION_MAX_FRAME is always enough). Returns its length, or ORION_BAD_COUNT, ORION_BAD_VALUE, ORION_NO_ROOM.
 */
{encoders}

/*
 * Read one frame, with or without its delimiter. Returns its kind, or an error, and then leaves `out` alone.
 */
int orion_decode(const uint8_t *frame, size_t length, struct orion_frame *out);

/*
 * Finds the frames among the bytes that a UART receives. Set it to zeros (or orion_feeder_start) before the first byte;
 * its counters are what a heartbeat tells.
 */
struct orion_feeder {{
    uint32_t good;
    uint32_t damaged;
    uint16_t length;
    uint8_t overlong;
    uint8_t bytes[ORION_MAX_FRAME];
}};

void orion_feeder_start(struct orion_feeder *feeder);

/*
 * Take one byte. Returns 0 until a frame ends, then its kind or an error as orion_decode. A byte is only stored, save
 * for a frame's last, which decodes it: where an interrupt must not take that long, put a ring buffer in between.
 */
int orion_feed(struct orion_feeder *feeder, uint8_t byte, struct orion_frame *out);

#endif
"""


def source() -> str:
    """The text of ``orion_frames.c``."""
    parts = [
        f'{_GENERATED}\n#include "orion_frames.h"\n\n#include <string.h>\n',
        *(_put(width) + _get(width) for width in _WIDTHS),
        *(_signed(width) for width in _SIGNED_WIDTHS),
        _FRAMING,
        *(_packer(f"orion_{_item(group)}", group.fields) for group in _GROUPS.values()),
        *(_packer(f"orion_{layout.name}", layout.fields) for layout in LAYOUTS.values()),
        *map(_encoder, LAYOUTS.values()),
        *map(_decoder, LAYOUTS.values()),
        _dispatcher(),
        _FEEDER,
    ]
    return "\n".join(parts)


def write(folder: Path) -> list[Path]:
    """Write both files into the folder, which is made if need be; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "orion_frames.h", folder / "orion_frames.c"]
    for path, text in zip(paths, (header(), source()), strict=True):
        path.write_text(text, encoding="utf-8")
    return paths


_GENERATED = "/* Generated by python -m transport.firmware from transport/mcu_frames.py: change the table, not this. */"


def _item(group: Group) -> str:
    return group.name.removesuffix("s")


def _width(fields: tuple[Field, ...]) -> int:
    return sum(bits(field.c_type) // 8 for field in fields)


def _fixed(layout: Layout) -> int:
    """Bytes of content before the group: kind, version, fields, count."""
    return 2 + _width(layout.fields) + (1 if layout.group else 0)


def _unit(name: str) -> str:
    return next((f" [{unit}]" for ending, unit in _UNITS.items() if name.endswith(ending)), "")


# --- structs ------------------------------------------------------------------------------------------------------


def _member(field: Field) -> str:
    least, largest = limits(field)
    note = "" if (least, largest) == c_range(field.c_type) else f"; {least} to {largest}"
    return f"    {field.c_type} {field.name}; /* {field.meaning}{_unit(field.name)}{note} */\n"


def _group_struct(group: Group) -> str:
    members = "".join(map(_member, group.fields))
    return f"/* {_sentence(group.item.__doc__)} */\nstruct orion_{_item(group)} {{\n{members}}};\n"


def _frame_struct(layout: Layout) -> str:
    members = "".join(map(_member, layout.fields))
    frame_type = next(frame_type for frame_type, other in LAYOUTS.items() if other is layout)
    if layout.group:
        members += f"    uint8_t count; /* how many of the {layout.group.name} there are */\n"
        members += f"    struct orion_{_item(layout.group)} {layout.group.name}[ORION_MAX_BEAMS];\n"
    return f"/* {_sentence(frame_type.__doc__)} */\nstruct orion_{layout.name} {{\n{members}}};\n"


def _sentence(doc: str | None) -> str:
    return (doc or "").partition("\n")[0]


# --- bytes --------------------------------------------------------------------------------------------------------


def _put(width: int) -> str:
    half = width // 2
    lines = (
        "    to[0] = value;\n"
        if width == 8
        else f"    put_{half}(to, (uint{half}_t)value);\n"
        f"    put_{half}(to + {half // 8}, (uint{half}_t)(value >> {half}));\n"
    )
    return f"static void put_{width}(uint8_t *to, uint{width}_t value)\n{{\n{lines}}}\n\n"


def _get(width: int) -> str:
    half, whole = width // 2, f"uint{width}_t"
    value = (
        "from[0]" if width == 8 else f"({whole})(get_{half}(from) | ({whole})get_{half}(from + {half // 8}) << {half})"
    )
    return f"static {whole} get_{width}(const uint8_t *from)\n{{\n    return {value};\n}}\n"


def _signed(width: int) -> str:
    return f"""\
/* C leaves the conversion of large unsigned values to the compiler; this does not. */
static int{width}_t get_signed_{width}(const uint8_t *from)
{{
    uint{width}_t value = get_{width}(from);
    return value <= INT{width}_MAX ? (int{width}_t)value : (int{width}_t)(-1 - (int{width}_t)(UINT{width}_MAX - value));
}}
"""


def _packer(name: str, fields: tuple[Field, ...]) -> str:
    """Functions ``pack_NAME``, ``unpack_NAME`` and ``check_NAME`` for a row of fields."""
    packs, unpacks, checks, at = "", "", "", 0
    for field in fields:
        width = bits(field.c_type)
        signed = "" if field.c_type.startswith("u") else "signed_"
        packs += f"    put_{width}(to + {at}, (uint{width}_t)from->{field.name});\n"
        unpacks += f"    to->{field.name} = get_{signed}{width}(from + {at});\n"
        checks += _check(field)
        at += width // 8
    unused = "" if checks else "    (void)row;\n"
    return f"""\
static void pack_{name}(const struct {name} *from, uint8_t *to)
{{
{packs}}}

static void unpack_{name}(const uint8_t *from, struct {name} *to)
{{
{unpacks}}}

static int check_{name}(const struct {name} *row)
{{
{unused}{checks}    return 0;
}}
"""


def _check(field: Field) -> str:
    (least, largest), (can_be_least, can_be_largest) = limits(field), c_range(field.c_type)
    wrong = [f"row->{field.name} < {least}"] * (least > can_be_least)
    wrong += [f"row->{field.name} > {largest}"] * (largest < can_be_largest)
    return f"    if ({' || '.join(wrong)})\n        return ORION_BAD_VALUE;\n" if wrong else ""


_FRAMING = """\
/* CRC-16/IBM-3740, also called CCITT-FALSE: of "123456789" it is 0x29B1. */
static uint16_t crc_16(const uint8_t *bytes, size_t length)
{
    uint16_t crc = 0xFFFF;
    size_t at;
    int bit;
    for (at = 0; at < length; at++) {
        crc = (uint16_t)(crc ^ ((uint32_t)bytes[at] << 8));
        for (bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? ((uint32_t)crc << 1) ^ 0x1021 : (uint32_t)crc << 1);
    }
    return crc;
}

/* Put the checksum behind the content, which has two bytes to spare, and both, stuffed by COBS, into `out`. */
static int wrap(uint8_t *content, size_t length, uint8_t *out, size_t room)
{
    size_t from, code_at = 0, to = 1;
    uint8_t code = 1; /* a block's length, of its non-zero bytes and itself */
    put_16(content + length, crc_16(content, length));
    length += 2;
    if (room < length + length / 254 + 2)
        return ORION_NO_ROOM;
    for (from = 0; from < length; from++) {
        if (content[from] != 0) {
            out[to++] = content[from];
            code++;
        }
        if (content[from] == 0 || (code == 0xFF && from + 1 < length)) {
            out[code_at] = code;
            code_at = to++;
            code = 1;
        }
    }
    out[code_at] = code;
    out[to++] = 0;
    return (int)to;
}

/* Undo `wrap`, without the delimiter. `content` has ORION_MAX_CONTENT + 2 bytes. Returns the content's length. */
static int unwrap(const uint8_t *frame, size_t length, uint8_t *content)
{
    size_t from = 0, to = 0;
    while (from < length) {
        uint8_t code = frame[from++];
        size_t run = (size_t)code - 1;
        if (code == 0 || run > length - from || run > ORION_MAX_CONTENT + 2 - to)
            return ORION_DAMAGED;
        if (run > 0 && memchr(frame + from, 0, run) != NULL)
            return ORION_DAMAGED;
        memcpy(content + to, frame + from, run);
        from += run;
        to += run;
        if (code != 0xFF && from < length) {
            if (to == ORION_MAX_CONTENT + 2)
                return ORION_DAMAGED;
            content[to++] = 0;
        }
    }
    if (to < 2 || crc_16(content, to - 2) != get_16(content + to - 2))
        return ORION_DAMAGED;
    return (int)(to - 2);
}
"""


# --- frames -------------------------------------------------------------------------------------------------------


def _encoder_head(layout: Layout) -> str:
    return f"int orion_encode_{layout.name}(const struct orion_{layout.name} *frame, uint8_t *out, size_t room)"


def _encoder(layout: Layout) -> str:
    group = ""
    length = str(_fixed(layout))
    declared = ""
    if layout.group:
        item, items, size = _item(layout.group), layout.group.name, _width(layout.group.fields)
        declared = "    size_t n;\n"
        length = f"{_fixed(layout)} + (size_t)frame->count * {size}"
        group = f"""\
    if (frame->count > ORION_MAX_BEAMS)
        return ORION_BAD_COUNT;
    content[{_fixed(layout) - 1}] = frame->count;
    for (n = 0; n < frame->count; n++) {{
        if (check_orion_{item}(&frame->{items}[n]) < 0)
            return ORION_BAD_VALUE;
        pack_orion_{item}(&frame->{items}[n], content + {_fixed(layout)} + n * {size});
    }}
"""
    return f"""\
{_encoder_head(layout)}
{{
    uint8_t content[ORION_MAX_CONTENT + 2];
{declared}    if (check_orion_{layout.name}(frame) < 0)
        return ORION_BAD_VALUE;
    content[0] = ORION_{layout.name.upper()};
    content[1] = ORION_VERSION;
    pack_orion_{layout.name}(frame, content + 2);
{group}    return wrap(content, {length}, out, room);
}}
"""


def _decoder(layout: Layout) -> str:
    name, fixed = layout.name, _fixed(layout)
    declared, lengths, group = "", f"    if (length != {fixed})\n        return ORION_BAD_LENGTH;\n", ""
    if layout.group:
        item, items, size = _item(layout.group), layout.group.name, _width(layout.group.fields)
        declared = "    size_t n;\n"
        lengths = f"""\
    if (length < {fixed})
        return ORION_BAD_LENGTH;
    frame.count = content[{fixed - 1}];
    if (frame.count > ORION_MAX_BEAMS)
        return ORION_BAD_COUNT;
    if (length != {fixed} + (size_t)frame.count * {size})
        return ORION_BAD_LENGTH;
"""
        group = f"""\
    for (n = 0; n < frame.count; n++) {{
        unpack_orion_{item}(content + {fixed} + n * {size}, &frame.{items}[n]);
        if (check_orion_{item}(&frame.{items}[n]) < 0)
            return ORION_BAD_VALUE;
    }}
"""
    return f"""\
static int decode_{name}(const uint8_t *content, size_t length, struct orion_frame *out)
{{
    struct orion_{name} frame;
{declared}    memset(&frame, 0, sizeof frame);
{lengths}    unpack_orion_{name}(content + 2, &frame);
    if (check_orion_{name}(&frame) < 0)
        return ORION_BAD_VALUE;
{group}    out->kind = ORION_{name.upper()};
    out->as.{name} = frame;
    return ORION_{name.upper()};
}}
"""


def _dispatcher() -> str:
    cases = "".join(
        f"    case ORION_{layout.name.upper()}:\n        return decode_{layout.name}(content, (size_t)size, out);\n"
        for layout in LAYOUTS.values()
    )
    return f"""\
int orion_decode(const uint8_t *frame, size_t length, struct orion_frame *out)
{{
    uint8_t content[ORION_MAX_CONTENT + 2];
    int size;
    if (length > 0 && frame[length - 1] == 0)
        length--;
    if (length >= ORION_MAX_FRAME)
        return ORION_DAMAGED;
    size = unwrap(frame, length, content);
    if (size < 0)
        return size;
    if (size < 2)
        return ORION_BAD_LENGTH;
    if (content[1] != ORION_VERSION)
        return ORION_BAD_VERSION;
    switch (content[0]) {{
{cases}    default:
        return ORION_BAD_KIND;
    }}
}}
"""


_FEEDER = """\
void orion_feeder_start(struct orion_feeder *feeder)
{
    memset(feeder, 0, sizeof *feeder);
}

int orion_feed(struct orion_feeder *feeder, uint8_t byte, struct orion_frame *out)
{
    int kind;
    if (byte != 0) {
        if (feeder->length < ORION_MAX_FRAME - 1)
            feeder->bytes[feeder->length++] = byte;
        else
            feeder->overlong = 1;
        return 0;
    }
    if (feeder->length == 0)
        return 0;
    kind = feeder->overlong ? ORION_DAMAGED : orion_decode(feeder->bytes, feeder->length, out);
    feeder->length = 0;
    feeder->overlong = 0;
    if (kind == ORION_DAMAGED)
        feeder->damaged++;
    else
        feeder->good++;
    return kind;
}
"""


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m transport.firmware DIR")
    for path in write(Path(sys.argv[1])):
        print(path)
