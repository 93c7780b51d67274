#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes the files of this folder, that other programs write: the document's Motor Data on two buses and a Command, by
python-can 4.6 (not needed to test them), and by hand what it does not write.  docs/files.md says which of them open."""
import pathlib
import subprocess

import can

FOLDER = pathlib.Path(__file__).resolve().parent
MOTOR = bytes.fromhex("FD7FFD7FFD7FFD7FF5AFFD7F18010000014000000000E38CD23CE04E000005FF")
START = bytes.fromhex("BBBE6FC720000000")
PARTS = [(1, START), (2, MOTOR[:8]), (2, MOTOR[8:16]), (2, MOTOR[16:24]), (3, MOTOR[24:])]


def classic():
    """Motor Data on two buses, one behind the other, then a Command and a frame of somebody else."""
    frames = [(channel, 0x210 << 18 | ctrl << 14, data, True) for channel in (0, 1) for ctrl, data in PARTS]
    frames += [(0, 0, bytes.fromhex("01A500FD7FD980"), True), (0, 0x123, b"12", False)]
    for count, (channel, number, data, extended) in enumerate(frames):
        yield can.Message(timestamp=1700000000 + count / 1000, arbitration_id=number, data=data, channel=channel,
                          is_extended_id=extended)


def fd():
    for count, (ctrl, data) in enumerate([(1, START), (3, MOTOR)]):
        yield can.Message(timestamp=1700000000 + count / 1000, arbitration_id=0x210 << 18 | ctrl << 14, data=data, channel=0,
                          is_fd=True, bitrate_switch=True)


def number_of(message):
    return f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"


def write(name, messages):
    with can.Logger(str(FOLDER / name)) as log:
        for message in messages:
            log(message)


def by_hand(messages):
    """PEAK's TRC 1.1, OVMS's CRTD and SavvyCAN's CSV."""
    peak = [";$FILEVERSION=1.1", ";$STARTTIME=45244.9259259259", ";"]
    crtd, savvy = [], ["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    for count, message in enumerate(messages, 1):
        data = message.data.hex(" ").upper()
        peak.append(f"{count:6d}){count - 1:10.1f}  Rx  {number_of(message):>12}  {message.dlc}  {data}")
        crtd.append(f"{message.timestamp:.6f} {message.channel + 1}R{29 if message.is_extended_id else 11} "
                    f"{number_of(message)} {data}")
        savvy.append(f"{round(message.timestamp * 1e6)},{number_of(message)},{str(message.is_extended_id).lower()},Rx,"
                     f"{message.channel},{message.dlc},{data.replace(' ', ',')},")
    for name, lines in (("motor_1_1.trc", peak), ("motor.crt", crtd), ("motor_savvycan.csv", savvy)):
        (FOLDER / name).write_text("\n".join(lines) + "\n")


def main():
    for ending in ("blf", "asc", "log", "csv"):
        write(f"motor.{ending}", classic())
        if ending != "csv":  # it cannot say what CAN FD is
            write(f"motor_fd.{ending}", fd())
    write("motor_2_1.trc", classic())
    by_hand(list(classic()))
    for source in ("motor.blf", "motor.log", "../two_interfaces.pcapng"):
        packed = FOLDER / pathlib.Path(source).name
        for ending, command in (("gz", ["gzip", "-9nc"]), ("zst", ["zstd", "-qc"]), ("lz4", ["lz4", "-qc"])):
            done = subprocess.run([*command, FOLDER / source], check=True, stdout=subprocess.PIPE)
            packed.with_name(f"{packed.name}.{ending}").write_bytes(done.stdout)


if __name__ == "__main__":
    main()
