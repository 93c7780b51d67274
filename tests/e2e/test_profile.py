# SPDX-License-Identifier: GPL-2.0-or-later
"""profiles/YAPP: every name in it is a field, the columns and the colours are what tshark makes of them, and their
texts can be read."""
import csv
import re
import shutil

import pytest
import make
import levels
import tshark

PROFILE = tshark.ROOT / "profiles/YAPP"


def lines_of(name):
    return [line for line in (PROFILE / name).read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]


def uat(name):
    return list(csv.reader(lines_of(name)))


def colour_rules():
    """name -> filter, background, text; the colours as three numbers from 0 to 1."""
    rules = {}
    for line in lines_of("colorfilters"):
        name, text, back, front = re.fullmatch(r"@([^@]*)@([^@]*)@\[([\d,]*)\]\[([\d,]*)\]", line).groups()
        rules[name] = text, *([int(part) / 65535 for part in colour.split(",")] for colour in (back, front))
    return rules


@pytest.fixture(scope="module")
def home():
    """A home with the profile."""
    path = tshark.writable_folder()
    shutil.copytree(PROFILE, path / ".config/wireshark/profiles/YAPP")
    tshark.open_to_all(path)
    yield path
    shutil.rmtree(path, ignore_errors=True)


def run(home, *arguments):
    return tshark.run("-C", "YAPP", *tshark.load(), *arguments, plugin=False, env={"HOME": str(home)})


if tshark.ROUTE == "plugin":  # the home of the tests has it in its plugin folder, this one has not
    pytestmark = pytest.mark.skip(reason="the same by both routes")


@pytest.fixture(scope="module")
def known():
    """The names of all fields; -G takes no -X, so the plugin has to lie in a plugin folder."""
    path = tshark.writable_folder()
    tshark.install_plugin(path / tshark.PERSONAL_FOLDER / "yapp")
    tshark.open_to_all(path)
    done = tshark.run("-G", "fields", plugin=False, env={"HOME": str(path)})
    yield {line.split("\t")[2] for line in done.stdout.splitlines() if line.count("\t") > 1}
    shutil.rmtree(path, ignore_errors=True)


def test_every_name_is_a_field(known):
    texts = [text for text, _, _ in colour_rules().values()]
    texts += [row[2] for row in uat("dfilter_buttons")]
    texts += [text for row in uat("io_graphs") for text in (row[2], row[6])]
    texts += [text for row in uat("plots") for text in (row[3], row[6])]
    texts += re.findall(r"%Cus:([\w.]+):", (PROFILE / "preferences").read_text())
    names = set(re.findall(r"(?:yapp|taurus)[\w.]*", " ".join(texts)))
    assert len(names) > 20 and names - known == set()


def test_columns(home):
    done = run(home, "-r", tshark.CAPTURES / "serial/document_uart.pcap", "-T", "psml")
    titles = re.findall(r"<section>(.*?)</section>", done.stdout.split("</structure>")[0])
    assert titles == ["No.", "Time", "Source", "RPM", "Commanded RPM", "Voltage V", "Current A", "Power W", "Motor °C", "State", "Info"]
    values = dict(zip(titles, re.findall(r"<section>(.*?)</section>", done.stdout.split("</structure>")[1])))
    assert (values["Voltage V"], values["RPM"]) == ("47.97", "0")
    assert float(values["Power W"]) == round(float(values["Voltage V"]) * float(values["Current A"]))
    assert values["Source"].endswith("0x210") and values["State"] == "ready, stopped"


def columns(home, *arguments):
    """The columns Source and State of each packet that has a state, and the faults with which Info begins."""
    done = run(home, *arguments, "-T", "psml")
    rows = [re.findall(r"<section>(.*?)</section>", row) for row in done.stdout.split("<packet>")[1:]]
    return [(row[2], row[9], re.match("(?:FAULT (.*?)(?:  |$))?", row[10])[1] or "") for row in rows if row[9]]


def test_a_column_for_each_controller(home):
    """By the options that docs/profile.md shows."""
    page = (tshark.ROOT / "docs/profile.md").read_text()
    sources = re.search(r'-o "(yapp\.sources:[^"]*)"', page)[1]
    rows = columns(home, "-o", sources, "-r", tshark.ROOT / "docs/flight.pcapng")
    assert {row[0] for row in rows} == {"left", "right"}
    for name in re.findall(r'`yapp.source == "(\w+)"`', page):
        found = run(home, "-o", sources, "-r", tshark.ROOT / "docs/flight.pcapng", "-Y", f'yapp.source == "{name}" && taurus.motor')
        assert found.stdout


@levels.without_tshark("reads the profile's files")
def test_a_motor_that_stops_is_seen():
    """The highest value of a second hides it."""
    shown = {(row[5], row[6]) for row in uat("io_graphs") if row[0] == "Enabled"}
    assert {("MIN(Y Field)", "taurus.motor.rpm_measured"), ("MAX(Y Field)", "taurus.motor.rpm_measured")} <= shown


@levels.without_tshark("reads the profile's files")
def test_several_controllers_are_no_average_and_no_zigzag():
    for row in uat("io_graphs"):
        assert row[4] in ("Dot", "Plus", "Impulse") and not row[5].startswith("AVG"), row
    assert {row[5] for row in uat("plots")} == {"Dot", "Plus"}


def test_a_damaged_message_is_no_value_and_no_fault(home):
    """Buttons and graphs of values leave it out; no rule colours its faults."""
    rows = [row[2] for row in uat("dfilter_buttons") if re.search("taurus.command|taurus.value", row[2])]
    rows += [row[2] for row in uat("io_graphs") if row[6]] + [row[3] for row in uat("plots")]
    assert len(rows) == 17 and all("!yapp.crc.bad" in text for text in rows)
    events = tshark.CAPTURES / "can/events.pcap"
    row, = run(home, "--color", "-r", events, "-Y", "yapp.crc.bad", "-T", "fields", "-e", "taurus.motor.fault_flags", "-e",
               "taurus.fault.active", "-e", "yapp.message.fault", "-e", "frame.coloring_rule.name").stdout.splitlines()
    assert row.split("\t") == ["0xffffffff", "", "", "YAPP bad CRC"]


COLOURED = {"bad_crc_can": "YAPP bad CRC", "lost_middle": "YAPP incomplete or stray",
            "end_without_start": "YAPP incomplete or stray", "middle_without_start": "YAPP incomplete or stray",
            "unknown_id": "YAPP not decoded", "document_motor": "YAPP fragment", "invalid_key": "YAPP command ignored",
            "fault_flags": "YAPP fault raised"}


def test_colours(home, folder):
    """Of all captures in one file, each from an interface of its own."""
    sources = [make.read(name) for name in COLOURED]
    (folder / "all.pcapng").write_bytes(make.pcapng(*sources))
    done = run(home, "--color", "-r", folder / "all.pcapng", "-T", "fields", "-e", "frame.coloring_rule.name")
    assert "Could not compile" not in done.stderr
    rows = done.stdout.splitlines()
    for rule, source in zip(COLOURED.values(), sources):
        assert rule in rows[:len(source.packets)], rule
        del rows[:len(source.packets)]
    assert rows == []
