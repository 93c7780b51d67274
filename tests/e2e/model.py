# SPDX-License-Identifier: GPL-2.0-or-later
"""What a capture has to show, worked out without the plugin: the tables of the document typed once more, the float codec as its
formula, and the CRC a bit at a time (test_captures/make.py).

A message is one entry of MESSAGES: filter names, sweeps over its flags and reserved counts, random flights and streams, and
values follow from it.  Other names are lines of tests/published.txt."""
import math
import re
import struct

import published

MOTOR, HEALTH, COMMAND = 0x210, 0x200, 0x000
MAPPING, WORKED_EXAMPLES = 6, 5  # what 2^N is reduced by

# Expert items and fields of YAPP's own that are worked out from more than one message: they stand in no .expected file.
CHANGE_EXPERTS = ["yapp.late", "taurus.reboot", "taurus.stale", "taurus.fault.raised", "taurus.fault.cleared", "taurus.jump"]
EVENT_EXPERTS = [*CHANGE_EXPERTS, "taurus.disabled", "yapp.source.shared", "yapp.unfinished", "yapp.copy"]
EXPERTS = [name for name in published.of("expert") if name not in (*EVENT_EXPERTS, "yapp.can.id.missing")]
HISTORY = re.compile(r"yapp\.(bus|source|message\.fault|seq\.missing|copy_of|reassembled\.data|fragment\.data|like\..*)$")
YAPP = {name.removeprefix("yapp."): kind for name, kind in published.of("field").items()
        if name.startswith("yapp.") and not HISTORY.match(name)}

# A kind of event by its name: { key of its line in published.txt: text }.
KINDS = {name: dict(word.partition("=")[::2] for word in line.split()) for name, line in published.of("kind").items()}
RULES = [name for name, kind in KINDS.items() if not kind.keys() & {"counts_as", "is_optional"}]  # of `check` alone
STATISTICS = published.of("statistic")
IN_TEXT = [name for name in STATISTICS if name not in ("csv", "check", "watch")]  # a table, as text or as JSON

FAULT = {
    0x1: "oc_limit_unmeasurable", 0x2: "cbc_oc_lpdac", 0x4: "pwm_saturated", 0x8: "stack_overflow",
    0x10: "open_loop_speed_low", 0x20: "est_angle_diff", 0x40: "foc_time_exceeded", 0x80: "bus_voltage_limit",
    0x100: "pi_gain_range", 0x200: "stall_filter_floor", 0x400: "est_speed_diff", 0x800: "atpi_warning",
    0x1000: "control_freq_ratio", 0x2000: "hall_period_invalid", 0x4000: "coast_timeout", 0x8000: "est_diff_timeout",
    0x1_0000: "motor_overcurrent", 0x2_0000: "bus_voltage_disabled", 0x4_0000: "open_phase",
    0x10_0000: "flash_crc", 0x20_0000: "critical_parameter", 0x40_0000: "afe_init", 0x80_0000: "motor_stall",
    0x100_0000: "ppm_timeout", 0x200_0000: "adc_calibration", 0x400_0000: "est_inputs_invalid",
    0x1000_0000: "hall_timeout", 0x2000_0000: "start_wrong_direction", 0x4000_0000: "hardware_over_temperature",
    0x8000_0000: "reserved",
}
STATUS = {
    0x2: "foc_align", 0x1000: "start_in_motion_no_bemf", 0x2000: "start_in_motion_bemf", 0x4000: "waiting_for_stop",
    0x8000: "braking", 0x1_0000: "stopped", 0x2_0000: "enabled", 0x4_0000: "open_loop", 0x8_0000: "closed_loop_ramp",
    0x10_0000: "closed_loop", 0x20_0000: "closed_loop_2", 0x40_0000: "reverse_direction",
    0x80_0000: "field_weakening", 0x100_0000: "overmodulation", 0x200_0000: "hall_position",
    0x4000_0000: "mpos_update",
}
STATE = {0x1: "ready", 0x2: "running", 0x4: "stopped", 0x8: "overmodulated", 0x10: "saturated", 0x20: "faulted"}
FAULTED = 0x20
HEALTH_STATUS = {0x1: "regeneration_enabled", 0x2: "reversed", 0x4: "precharging"}

TEMPERATURE, CURRENT, PERCENT, RIPPLE = (-40, 210, "°C"), (-128, 128, "A"), (0, 100, "%"), (0, 12.5, "V")
SPEED = (-60000, 60000, "RPM")
MEANINGS = {
    "enabled": {0: "Disabled", 1: "Enabled"}, "motor_mode": {0: "Torque Mode", 1: "Speed Mode"},
    "key": {0xA5: "Full Operation", 0x5A: "No Regeneration Allowed"},
}


class Flags(tuple):
    """A field of flags: (group, {bit: name}), and which bits are faults."""

    def __new__(cls, group, bits, faults=0):
        self = super().__new__(cls, (group, bits))
        self.faults = faults
        return self


class Number:
    """A field of which every value is defined: an unsigned integer, or what `read` makes of its bytes.

    type: Wireshark's, of an integer without the width; column: its type in tables; make: function(rng, size) -> bytes."""

    def __init__(self, type_="UINT", column="integer", read=lambda data: int.from_bytes(data, "little"), make=None):
        self.type, self.column, self.read = type_, column, read
        self.make = make or (lambda rng, size: rng.randrange(2 ** (8 * size) - 1).to_bytes(size, "little"))

    def value(self, count, size):
        return self.read(count.to_bytes(size, "little"))


REAL = Number("DOUBLE", "float", lambda data: struct.unpack("<d" if len(data) == 8 else "<f", data)[0],
              lambda rng, size: struct.pack("<d" if size == 8 else "<f", rng.uniform(-1000, 1000)))
TEXT = Number("STRING", "string", lambda data: escaped(data.partition(b"\0")[0]), lambda rng, size: bytes(rng.choice(b"abc xyz") for _ in range(size)))


def escaped(data):
    """A text whose control characters, and bytes that are not UTF-8, are \\xnn."""
    text = data.decode("utf-8", "backslashreplace")
    return re.sub("[\0-\x1f\x7f-\x9f]", lambda found: "".join(f"\\x{byte:02x}" for byte in found[0].encode()), text)


class Message(tuple):
    """A message: (name, title, fields), the fields in the document's order: name, size in bytes, and what it is: (min, max,
    unit) for a compressed float, Flags, a set of the values that the document defines, None for a time; Number(), REAL (IEEE 754) or TEXT.

    every: its period in seconds, or None; answers: the message that commands it; least: its size in an earlier table.  generated:
    { name: (field, operator, field) }, of which derived are in tables, too: as published.  alarms: { field: its bits that are faults }."""

    def __new__(cls, name, title, fields, every=None, answers=None, least=None):
        self = super().__new__(cls, (name, title, fields))
        self.name, self.every, self.answers = name, every, answers
        self.size = sum(size for _, size, _ in fields)
        self.least = least or self.size
        formulas = {path.removeprefix(f"{name}."): text for path, text in published.of("formula").items() if path.startswith(f"{name}.")}
        self.generated = {value: tuple(text.split()) for value, text in formulas.items()}
        self.derived = [value for value in self.generated if f"{name}.{value}" in published.of("column")]
        self.alarms = {field: kind.faults for field, _, kind in fields if isinstance(kind, Flags) and kind.faults}
        groups = [(kind.faults != 2 ** (8 * size) - 1, at, kind[0]) for at, (_, size, kind) in enumerate(fields)
                  if isinstance(kind, Flags) and kind.faults]
        self.fault_group = min(groups)[2] if groups else None  # whose changes are linked: of nothing but faults, if there is one
        self.has_clock = any(kind is None for _, _, kind in fields)
        return self

    def counts(self, payload):
        """The fields that a payload has: (name, size, kind, count)."""
        at = 0
        for field, size, kind in self[2]:
            if at + size <= len(payload):
                yield field, size, kind, int.from_bytes(payload[at:at + size], "little")
            at += size


MESSAGES = {
    COMMAND: Message("command", "Command", [
        ("enabled", 1, set(MEANINGS["enabled"])), ("key", 1, set(MEANINGS["key"])), ("motor_mode", 1, set(MEANINGS["motor_mode"])),
        ("torque_iq", 2, (-200, 200, "A")), ("rpm", 2, (-100000, 100000, "RPM"))], 0.2),
    MOTOR: Message("motor", "Motor Data", [
        ("torque_iq_commanded", 2, CURRENT), ("torque_iq_measured", 2, CURRENT),
        ("rpm_commanded", 2, SPEED), ("rpm_measured", 2, SPEED),
        ("dc_voltage", 2, (-128, 128, "V")), ("dc_current", 2, CURRENT),
        ("motor_temperature", 1, TEMPERATURE), ("motor_mode", 1, set(MEANINGS["motor_mode"])),
        ("status_flags", 4, Flags("status", STATUS)), ("fault_flags", 4, Flags("fault", FAULT, 0xFFFF_FFFF)),
        ("timestamp", 8, None), ("motor_state", 1, Flags("state", STATE, FAULTED)), ("esc_temperature", 1, TEMPERATURE)],
        0.1, "command"),
    HEALTH: Message("health", "Health", [
        ("timestamp", 8, None), ("control_thread_cpu", 1, PERCENT), ("taurus_thread_cpu", 1, PERCENT),
        ("cpu_temperature", 1, TEMPERATURE), ("capacitor_temperature", 1, TEMPERATURE),
        ("fet_temperature", 1, TEMPERATURE), ("vin_rms_ripple", 1, RIPPLE), ("vin_pp_ripple", 1, RIPPLE),
        ("taurus_status", 1, Flags("status", HEALTH_STATUS)), ("board_revision", 1, Number())], 0.5),
}


def is_float(kind):
    return isinstance(kind, tuple) and len(kind) == 3


def is_flags(kind):
    return isinstance(kind, tuple) and len(kind) == 2


def value(count, size, low, high, divisor=MAPPING):
    """A compressed float: floatN <low; high>, N = 8 * size."""
    return low + count * (high - low) / (2 ** (8 * size) - divisor)


def time_text(nanoseconds):
    """A time as Wireshark writes it."""
    seconds, rest = divmod(abs(nanoseconds), 10**9)
    return f"{'-' if nanoseconds < 0 else ''}{seconds}.{rest:09d}"


def number(text):
    """A double to the seven digits that a count can carry: versions print different numbers of them."""
    return f"{float(text):.7g}"


def filters():
    """Every filter name of the Taurus messages with its type, without FT_."""
    names = {}
    for name, _, fields in MESSAGES.values():
        names[f"taurus.{name}"] = "NONE"
        for field, size, kind in fields:
            path = f"taurus.{name}.{field}"
            whole = kind.type if isinstance(kind, Number) else "UINT" if kind else "RELATIVE_TIME"
            names[path] = "DOUBLE" if is_float(kind) else f"{whole}{8 * size}" if whole.endswith("INT") else whole
            if names[path] == "DOUBLE":
                names[f"{path}.special"] = "UINT8"
            elif is_flags(kind):
                names.update((f"taurus.{name}.{kind[0]}.{flag}", "BOOLEAN") for flag in kind[1].values())
    return names


def sweep(ident):
    """Payloads of a message: each bit of each field of flags alone, none and all; each reserved count of each compressed
    float; each other count at both ends, times behind the others, as a clock that goes back is a reboot.  The rest are
    ordinary values."""
    fields = MESSAGES[ident][2]
    usual = {field: min(kind) if isinstance(kind, set) else 0 for field, _, kind in fields}
    found = [usual]
    for field, size, kind in sorted(fields, key=lambda row: row[2] is None):
        top = 2 ** (8 * size) - 1
        if is_float(kind):
            counts = [top - special for special in range(6)]
        elif is_flags(kind):
            counts = [1 << bit for bit in range(8 * size)] + [top]
        else:
            counts = [0, top]
        found += [usual | {field: count} for count in counts]
    return [b"".join(counts[field].to_bytes(size, "little") for field, size, _ in fields) for counts in found]


def alarms(ident, payload=None):
    """The faults of a message, or those that are set in a payload, as (field, flag): in the order of the table, of each field
    those that it does not define behind the others."""
    message, found = MESSAGES[ident], []
    for field, size, kind, count in message.counts(payload or bytes(MESSAGES[ident].size)):
        count = message.alarms.get(field, 0) & (-1 if payload is None else count)
        bits = {1 << place: f"undefined_{1 << place:#x}" for place in range(8 * size)} if count else {}
        names = kind[1] if count else {}
        found += [(field, flag) for bit, flag in [*names.items(), *bits.items()]
                  if count & bit and (flag in names.values() or bit not in names)]
    return found


OPERATORS = {"-": lambda a, b: a - b, "*": lambda a, b: a * b, "+": lambda a, b: a + b}


def numbers(ident, payload):
    """The values that can be averaged: {field: value}; None where a count is reserved."""
    found = {}
    for field, size, kind, count in MESSAGES[ident].counts(payload):
        if is_float(kind):
            found[field] = value(count, size, kind[0], kind[1]) if count <= 2 ** (8 * size) - MAPPING else None
        elif isinstance(kind, Number) and kind.column != "string":
            found[field] = kind.value(count, size) if math.isfinite(kind.value(count, size)) else None
    for name, (a, operator, b) in MESSAGES[ident].generated.items():
        values = found.get(a), found.get(b)
        found[name] = None if None in values else OPERATORS[operator](*values)
    return found


def generated(ident, payload):
    """The values that are worked out from two fields: { filter name: number }."""
    return {f"taurus.{MESSAGES[ident].name}.{name}": number for name, number in numbers(ident, payload).items()
            if name in MESSAGES[ident].generated and number is not None}


def decode(ident, payload, divisor=MAPPING):
    """What the fields of a message show: {filter name: text}, and the expert items it raises: a list of names."""
    name = MESSAGES[ident].name
    shown, experts = {f"taurus.{name}": "1"}, []
    for field, size, kind, count in MESSAGES[ident].counts(payload):
        path = f"taurus.{name}.{field}"
        if kind is None:
            shown[path] = time_text(count - (count >> 63 << 64))
        elif is_float(kind):
            special = 2 ** (8 * size) - 1 - count
            if special < 5:
                shown[f"{path}.special"] = str(special)
                experts.append("taurus.value.special")
            else:
                shown[path] = number(value(count, size, kind[0], kind[1], divisor))
        elif is_flags(kind):
            group, bits = kind
            shown[path] = f"0x{count:0{2 * size}x}"
            for bit, flag in bits.items():
                shown[f"taurus.{name}.{group}.{flag}"] = "1" if count & bit else "0"
            if count & MESSAGES[ident].alarms.get(field, 0):
                experts.append("taurus.fault.active")
            if count & ~sum(bits):
                experts.append("taurus.flags.undefined")
        elif isinstance(kind, Number) and kind.column == "float" and not math.isfinite(kind.value(count, size)):
            shown[f"{path}.special"] = str(["nan", "inf", "-inf"].index(str(kind.value(count, size))))
            experts.append("taurus.value.special")
        elif isinstance(kind, Number):
            value_ = kind.value(count, size)
            shown |= {path: number(value_) if kind.column == "float" else str(value_)} if value_ != "" else {}
        else:
            shown[path] = f"0x{count:02x}" if isinstance(kind, set) else str(count)
            if count not in kind:
                experts.append("taurus.command.key.invalid" if field == "key" else "taurus.value.invalid")
    return shown, experts
