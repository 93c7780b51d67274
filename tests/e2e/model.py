# SPDX-License-Identifier: GPL-2.0-or-later
"""What a capture has to show, worked out without the plugin: the tables of the document and of the list of filter
names typed once more, the float codec as its formula, and the CRC a bit at a time (test_captures/make.py)."""
import struct

MOTOR, HEALTH, COMMAND = 0x210, 0x200, 0x000
MAPPING, WORKED_EXAMPLES = 6, 5  # what 2^N is reduced by

YAPP = {
    "id": "UINT32", "ctl": "UINT8", "seq": "UINT8", "size": "UINT16", "reserved": "UINT16", "sync": "UINT16",
    "can.ctrl": "UINT8", "crc": "UINT32", "crc.status": "UINT8", "crc.calculated": "UINT32", "payload": "BYTES",
    "undecoded": "BYTES", "padding": "BYTES", "fragments": "NONE", "fragment": "FRAMENUM", "fragment.count": "UINT32",
    "reassembled.in": "FRAMENUM", "reassembled.length": "UINT32", "skipped": "BYTES", "time_delta": "RELATIVE_TIME",
}
YAPP_EXPERTS = ["crc.bad", "fragment.orphan", "fragment.incomplete", "fragment.overrun", "size.mismatch", "id.unknown",
                "reserved.nonzero", "can.ctrl.invalid", "stream.skipped", "truncated", "fragment.duplicate"]
TAURUS_EXPERTS = ["fault.active", "command.key.invalid", "value.special", "flags.undefined", "value.invalid"]
# Worked out from more than one message: what test_flight_fields.py is about.
EVENT_EXPERTS = ["yapp.late", "yapp.unfinished", "taurus.fault.raised", "taurus.fault.cleared", "taurus.reboot", "taurus.stale",
                 "taurus.jump", "yapp.source.shared"]
CHANGES = {"yapp.bus": "STRING", "yapp.source": "STRING", "yapp.message.fault": "BOOLEAN", "yapp.seq.missing": "UINT8",
           "yapp.reassembled.data": "BYTES"}
CHANGES |= {f"taurus.motor.{group}.{way}": "UINT8" if group == "state" else "UINT32"
            for group in ("fault", "status", "state") for way in ("raised", "cleared")}
CHANGES |= {f"taurus.{name}": kind for name, kind in {
    "health.status.raised": "UINT8", "health.status.cleared": "UINT8", "motor.fault.active_time": "RELATIVE_TIME",
    "motor.fault.previous_change": "FRAMENUM", "motor.fault.next_change": "FRAMENUM", "motor.rpm_error": "DOUBLE",
    "motor.torque_iq_error": "DOUBLE", "motor.dc_power": "DOUBLE", "motor.command_in": "FRAMENUM", "motor.clock_drift": "RELATIVE_TIME",
    "health.clock_drift": "RELATIVE_TIME", "motor.status_flags.names": "STRING", "motor.fault_flags.names": "STRING",
    "motor.motor_state.names": "STRING", "health.taurus_status.names": "STRING"}.items()}
EXPERTS = [f"yapp.{name}" for name in YAPP_EXPERTS] + [f"taurus.{name}" for name in TAURUS_EXPERTS]

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
ALARMS = {"status_flags": 0, "fault_flags": 0xFFFF_FFFF, "motor_state": FAULTED}  # the bits that are faults
HEALTH_STATUS = {0x1: "regeneration_enabled", 0x2: "reversed", 0x4: "precharging"}

TEMPERATURE, CURRENT, PERCENT, RIPPLE = (-40, 210, "°C"), (-128, 128, "A"), (0, 100, "%"), (0, 12.5, "V")
SPEED = (-60000, 60000, "RPM")

# Message: name, title, and its fields in the document's order: name, size in bytes, and what it is: (min, max, unit)
# for a compressed float, (group, bits) for flags, a set of the values that the document defines.
MESSAGES = {
    COMMAND: ("command", "Command", [
        ("enabled", 1, {0, 1}), ("key", 1, {0xA5, 0x5A}), ("motor_mode", 1, {0, 1}),
        ("torque_iq", 2, (-200, 200, "A")), ("rpm", 2, (-100000, 100000, "RPM"))]),
    MOTOR: ("motor", "Motor Data", [
        ("torque_iq_commanded", 2, CURRENT), ("torque_iq_measured", 2, CURRENT),
        ("rpm_commanded", 2, SPEED), ("rpm_measured", 2, SPEED),
        ("dc_voltage", 2, (-128, 128, "V")), ("dc_current", 2, CURRENT),
        ("motor_temperature", 1, TEMPERATURE), ("motor_mode", 1, {0, 1}),
        ("status_flags", 4, ("status", STATUS)), ("fault_flags", 4, ("fault", FAULT)),
        ("timestamp", 8, None), ("motor_state", 1, ("state", STATE)), ("esc_temperature", 1, TEMPERATURE)]),
    HEALTH: ("health", "Health", [
        ("timestamp", 8, None), ("control_thread_cpu", 1, PERCENT), ("taurus_thread_cpu", 1, PERCENT),
        ("cpu_temperature", 1, TEMPERATURE), ("capacitor_temperature", 1, TEMPERATURE),
        ("fet_temperature", 1, TEMPERATURE), ("vin_rms_ripple", 1, RIPPLE), ("vin_pp_ripple", 1, RIPPLE),
        ("taurus_status", 1, ("status", HEALTH_STATUS)), ("board_revision", 1, set(range(256)))]),
}
SPECIALS = ["Not a Number", "Positive Infinity", "Negative Infinity", "Out of Range High", "Out of Range Low"]


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
            names[path] = "DOUBLE" if is_float(kind) else f"UINT{8 * size}" if kind else "RELATIVE_TIME"
            if is_float(kind):
                names[f"{path}.special"] = "UINT8"
            elif is_flags(kind):
                names.update((f"taurus.{name}.{kind[0]}.{flag}", "BOOLEAN") for flag in kind[1].values())
    return names


def alarms(payload=None):
    """The faults of Motor Data, or those that are set in a payload, as (field, flag): in the order of the table, of each
    field those that it does not define behind the others."""
    found, at = [], 0
    for field, size, kind in MESSAGES[MOTOR][2]:
        count = ALARMS.get(field, 0) & (-1 if payload is None else int.from_bytes(payload[at:at + size], "little"))
        bits = {1 << place: f"undefined_{1 << place:#x}" for place in range(8 * size)} if count else {}
        names = kind[1] if count else {}
        found += [(field, flag) for bit, flag in [*names.items(), *bits.items()]
                  if count & bit and (flag in names.values() or bit not in names)]
        at += size
    return found


def decode(ident, payload, divisor=MAPPING):
    """What the fields of a message show: {filter name: text}, and the expert items it raises: a list of names."""
    name, _, fields = MESSAGES[ident]
    shown, experts, at = {f"taurus.{name}": "1"}, [], 0
    for field, size, kind in fields:
        path = f"taurus.{name}.{field}"
        count = int.from_bytes(payload[at:at + size], "little")
        at += size
        if kind is None:
            shown[path] = time_text(struct.unpack("<q", payload[at - 8:at])[0])
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
            if count & ALARMS.get(field, 0):
                experts.append("taurus.fault.active")
            if count & ~sum(bits):
                experts.append("taurus.flags.undefined")
        else:
            shown[path] = f"0x{count:02x}" if kind <= {0, 1, 0xA5, 0x5A} else str(count)
            if count not in kind:
                experts.append("taurus.command.key.invalid" if field == "key" else "taurus.value.invalid")
    return shown, experts
