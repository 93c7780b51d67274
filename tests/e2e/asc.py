# SPDX-License-Identifier: GPL-2.0-or-later
"""Writes a flight as ASC, as CANoe, CANalyzer, BUSMASTER, python-can, log2asc and loggers write it."""
import time

WEEKDAYS, MONTHS = "Mon Tue Wed Thu Fri Sat Sun".split(), "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split()
HEADS = ["vector", "vector", "busmaster", "kvaser", "base"]
# Lines that are no data frames: recorders write them, and none is a loss.
KNOWN = ["{stamp} 1  Statistic: D 10 R 0 XD 90 XR 0 E 0 O 0 B 12.3%", "{stamp} CAN 1 Status:chip status error active", "// remark", "",
         "{stamp} 1  J1939TP FEE3p 6 0 0 - Rx d 39 ff ff", "{stamp} CANXL   2 Rx   XLFF   984438   4656      432  name e0 0", "{stamp} 1 OverloadFrame",
         "{stamp} Log Trigger Event (type=0x2, active=0x01)", "{stamp} Start der Messung", "{stamp} 1  123             TxRq d 2 01 02"]
# Lines that were frames, before they were damaged.
DAMAGED = ["{stamp} 1  8404000x        Rx   d 8 BB BE 6F", "{stamp} 1  840400", "8404000x Rx d 8 BB BE 6F C7 20 00 00 00", "{stamp} 1  MotorData Rx d 1 00",
           "{stamp} CANFD 1 Rx 8404000x 1 0 8 8 01 0x", "{stamp} 1 8404000x Rq d 1 01"]


def date(seconds, half_days, milliseconds):
    day = time.gmtime(seconds)
    hour, half = (day.tm_hour % 12 or 12, " pm" if day.tm_hour >= 12 else " am") if half_days else (day.tm_hour, "")
    return (f"{WEEKDAYS[day.tm_wday]} {MONTHS[day.tm_mon - 1]} {day.tm_mday} {hour:02d}:{day.tm_min:02d}:{day.tm_sec:02d}"
            f"{milliseconds}{half} {day.tm_year}")


class Log:
    """text; lost: number of damaged lines."""

    def __init__(self, rng, flight, damages=0):
        self.rng = rng
        self.head = rng.choice(HEADS)
        self.base = rng.choice(["hex", "dec"])
        self.is_relative = self.head in ("vector", "kvaser", "base") and rng.random() < 0.3
        self.case, self.kind, self.point = rng.choice([str.lower, str.upper, str.title]), rng.choice("dD"), rng.choice("..,")
        self.blank, self.end = rng.choice([" ", "  ", "\t"]), rng.choice(["\n", "\r\n"])
        self.zero = flight.begin // 10**9 * 10**6  # of the stamps
        if rng.random() < 0.3:  # a trigger in the middle: stamps in front of it are negative
            self.zero += 3 * 10**6
        self.last = self.zero
        lines, self.lost = self.header(), 0
        spoilt = set(rng.sample(range(len(flight.frames)), damages))
        for place, frame in enumerate(flight.frames):
            at = frame.at // 1000
            if rng.random() < 0.03:
                lines.append(self.filled(rng.choice(KNOWN), at))
            if place in spoilt:
                lines.append(self.filled(rng.choice(DAMAGED), at))
                self.lost += 1
            lines.append(self.line(frame, at))
        if self.head in ("vector", "kvaser"):
            lines.append("End TriggerBlock")
        self.text = self.end.join(lines) + self.end * (rng.random() < 0.8)

    def header(self):
        words = date(self.zero // 10**6, self.rng.random() < 0.5, self.rng.choice(["", ".000", ".0"]))
        timestamps = f"base {self.base}  timestamps {'relative' if self.is_relative else 'absolute'}"
        return {"vector": [f"date {words}", timestamps, "internal events logged", "// version 9.0.0", f"Begin Triggerblock {words}",
                           f"{self.stamp(self.zero)} Start of measurement"],
                "busmaster": [f"date {words}", f"base {self.base}  no internal events logged", "// version 7.1.0"],
                "kvaser": [f"date {words}", timestamps.replace("  ", " "), "// CAN channel: 1 2", "Begin Triggerblock"],
                "base": [timestamps]}[self.head]

    def has_date(self):
        return self.head in ("vector", "busmaster", "kvaser")

    def stamp(self, at):
        micro, self.last = (at - self.last if self.is_relative else at - self.zero), at
        sign, micro = "-" * (micro < 0), abs(micro)
        return f"{sign}{micro // 10**6}{self.point}{micro % 10**6:06d}" + self.rng.choice(["", "000"])

    def filled(self, line, at):
        return line.replace("{stamp}", self.stamp(at)) if "{stamp}" in line else line

    def line(self, frame, at):
        rng, is_dec = self.rng, self.base == "dec"
        ident = f"{frame.can_id:{'d' if is_dec else 'X'}}x"
        data = " ".join(f"{byte:{'3d' if is_dec else '02X'}}" for byte in frame.data)
        direction, channel = self.case(rng.choice(["rx", "tx"])), frame.bus + 1
        size = len(frame.data)
        if rng.random() < 0.2:  # a classic frame, as logs of CAN FD have it
            name = rng.choice(["", "  a_name "])
            words = [self.stamp(at), "CANFD", channel, direction, f"{ident}{name}", 0, 0, size, size, data, "0 0 0 0 0 0 0 0"]
        else:
            words = [self.stamp(at), channel, ident, direction, self.kind, size, data]
        return self.blank.join(map(str, words))
