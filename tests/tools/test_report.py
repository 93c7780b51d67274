# SPDX-License-Identifier: GPL-2.0-or-later
"""yapp-tables report: the page of a flight with known truth, in a real headless Chromium."""

import base64
import json
import re
import subprocess
import time
import zlib
from decimal import Decimal
from pathlib import Path

import flights
import pytest
from running import PLUGIN, TOP, run_tables
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

SECONDS = 120
EXAMPLE = Path(__file__).parents[2] / "docs/flight.pcapng"
NAMES = "yapp.sources:can0/0x210=motor:left, can1/0x210=motor:right"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    truth = flights.write(folder / "flight.pcapng", 7, SECONDS)
    options = [word for option in flights.OPTIONS for word in ("-o", option)]
    run_tables(folder, "report", "flight.pcapng", "--out", "flight.html", *options, "--plugin", PLUGIN, code=0)
    return folder / "flight.html", truth


def open_browser(path, width=None, link=""):
    options = webdriver.ChromeOptions()
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--window-size=1300,1000",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    if width:
        metrics = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 700}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get(path.as_uri() + link)
    for _ in range(600):
        if browser.execute_script("return document.documentElement.dataset.ready"):
            return browser
        time.sleep(0.1)
    raise AssertionError(browser.get_log("browser"))


@pytest.fixture(scope="module")
def browser(page):
    browser = open_browser(page[0])
    yield browser
    browser.quit()


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The page of docs/flight.pcapng, as README shows it."""
    folder = tmp_path_factory.mktemp("example")
    run_tables(folder, "report", EXAMPLE, "--out", "flight.html", "-o", NAMES, "--plugin", PLUGIN, code=0)
    return folder / "flight.html"


@pytest.fixture(scope="module", params=[390, 1200, 1920])
def example_browser(example, request):
    browser = open_browser(example, width=request.param)
    yield browser
    browser.quit()


def draw(browser):
    """Bring every picture into sight, so that it is drawn."""
    browser.set_script_timeout(120)
    browser.execute_async_script(
        """const done = arguments[0], pause = () => new Promise((after) => setTimeout(after, 20));
        (async () => { for (const plot of document.querySelectorAll(".plot")) {
          plot.scrollIntoView({block: "center"});
          while ("stale" in plot.dataset) await pause();
        } done(); })()"""
    )


def traces(browser, name, mode="lines"):
    """x and y of the traces whose name has this in it; None where there is no value."""
    draw(browser)
    script = """const [name, mode] = arguments;
      return [...document.querySelectorAll(".plot")].flatMap(plot => plot.data).filter(trace => trace.name.includes(name) && trace.mode === mode)
        .map(trace => ({name: trace.name, visible: trace.visible, x: Array.from(trace.x), y: Array.from(trace.y, y => Number.isNaN(y) ? null : y)}))"""
    return browser.execute_script(script, name, mode)


def x_range(browser):
    return [float(word) for word in browser.execute_script("return document.documentElement.dataset.seen").split(",")]


def show(browser, begin, end):
    """Zoom in one picture, and wait until all samples have followed."""
    draw(browser)
    browser.execute_async_script(
        """const done = arguments[2], plot = document.querySelector("figure[data-key*='.'] .plot");
        Plotly.relayout(plot, {"xaxis.range": [arguments[0], arguments[1]]}).then(() => setTimeout(done, 300))""",
        begin,
        end,
    )
    draw(browser)


def asked(browser):
    """Every address that the page asked for since this was called last."""
    messages = (json.loads(line["message"])["message"] for line in browser.get_log("performance"))
    return [
        message["params"]["request"]["url"] for message in messages if message["method"] == "Network.requestWillBeSent"
    ]


def test_it_opens_without_an_error_and_asks_the_network_for_nothing(browser, page):
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []
    assert {url for url in asked(browser) if not url.startswith(("data:", "blob:"))} == {page[0].as_uri()}
    assert browser.execute_script("return document.querySelectorAll('tr.part:not([hidden])').length") == 0


def incidents_of(browser):
    """The rows of the table of incidents, those that are unfolded too, with exact begin and end in seconds."""
    script = """return [...document.querySelectorAll("#incidents tbody tr")].map((row) => ({
      part: row.className === "part", fault: row.className === "fault", cells: [...row.cells].map((cell) => cell.textContent),
      begin: Number(row.dataset.begin), end: row.dataset.end }))"""
    return browser.execute_script(script)


def frames_between(path, begin, end):
    """The first and the last packet of these times in a file; to the last one if there is no end."""
    command = ["tshark", "-r", path, "-T", "fields", "-e", "frame.number", "-e", "frame.time_epoch"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    frames = [(int(number), int(Decimal(time).scaleb(9))) for number, time in map(str.split, lines)]
    found = [number for number, time in frames if begin <= time <= (end or frames[-1][1])]
    return found[0], found[-1]


def causes_of(browser):
    """The lines below the verdict: "F3 (can0): sentence; sentence."."""
    return browser.execute_script("return [...document.querySelectorAll('#causes li')].map(one => one.textContent)")


def test_each_fault_is_an_incident_with_the_truths_times(browser, page):
    truth = page[1]
    rows = [row for row in incidents_of(browser) if row["fault"]]
    assert len(rows) == len(truth.faults) == 2
    for row, (begin, end, bus, number, flag) in zip(rows, truth.faults, strict=True):
        seconds = (begin - truth.begin) / 1e9
        assert row["begin"] == pytest.approx(seconds, abs=1e-9)
        what, source, clock, utc, duration, frames, _ = row["cells"]
        assert what.lower().replace(" ", "_").startswith(flag)
        assert what.endswith("Faulted")
        assert source == f"{bus} 0x{number:03x}"
        assert clock == f"0:{seconds:06.3f}"
        first, last = (int(word.replace(",", "")) for word in frames.split(" to "))
        assert frames_between(page[0].with_name("flight.pcapng"), begin, end) == (first, last)
        assert utc == time.strftime("%H:%M:%S", time.gmtime(begin / 1e9)) + f".{round(begin / 1e6) % 1000:03}"
        if end is None:
            assert duration.startswith("still active, ")
        else:
            assert float(row["end"]) == pytest.approx((end - truth.begin) / 1e9, abs=1e-9)
            assert duration == f"{(end - begin) / 1e9:.3f} s"


def test_the_other_events_are_the_truths(browser, page):
    truth = page[1]
    whats = [row["cells"][0] for row in incidents_of(browser)]
    assert sum("reboot" in what for what in whats) >= len(truth.reboots)
    assert sum("silence" in what for what in whats) >= len({row[2] for row in truth.silences if row[3] > 1e9})
    # Lost frames are those of the message that they belong to.
    lost = [row["cells"] for row in incidents_of(browser) if row["cells"][0] == "lost frames"]
    counts = {(cells[1], cells[6].rpartition(", ")[2]): cells[6] for cells in lost}
    expected = {}
    for _, bus, number in truth.incomplete:
        expected[f"{bus} 0x{number:03x}", "Motor Data"] = expected.get((f"{bus} 0x{number:03x}", "Motor Data"), 0) + 1
    assert counts.keys() == expected.keys()
    for key, text in counts.items():
        assert int(text.partition(" times")[0] if "times" in text else 1) == expected[key]


def test_an_incident_unfolds_and_its_rows_are_buttons(example_browser):
    before = incidents_of(example_browser)
    (first,) = [row for row in before if row["fault"]]
    assert first["cells"][0] == "Motor overcurrent, Faulted, silence, reboot"
    card, *parts = [row["cells"] for row in before if row["part"]]
    assert [cells[0] for cells in parts] == ["Motor overcurrent", "Faulted", "silence", "reboot", "reboot"]
    command = ["tshark", "-q", "-r", EXAMPLE, "-X", f"lua_script:{PLUGIN}", "-o", NAMES, "-z", "yapp,fault,1"]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert card[0].strip() == told.strip()
    assert "motor_overcurrent" in told
    shown = "return [...document.querySelectorAll('tr.part')].map(row => row.offsetHeight > 0)"
    assert not any(example_browser.execute_script(shown))
    unfold = example_browser.find_element(By.CSS_SELECTOR, "#incidents [aria-expanded]")
    example_browser.execute_script("arguments[0].click()", unfold)
    assert all(example_browser.execute_script(shown))
    assert unfold.get_attribute("aria-expanded") == "true"
    example_browser.execute_script("arguments[0].click()", unfold)
    leads = "return [...document.querySelectorAll('#incidents > tbody > tr:not(:has(.card))')].every(row => row.cells[0].querySelector('button'))"
    assert example_browser.execute_script(leads)


def test_a_click_on_a_fault_zooms_to_it_on_all_axes(browser):
    first = next(row for row in incidents_of(browser) if row["fault"])
    begin, end = first["begin"], float(first["end"] or SECONDS)
    browser.execute_script("document.querySelector('#incidents tr.fault button').click()")
    time.sleep(1.5)
    low, high = x_range(browser)
    assert low < begin < end <= high + 1
    assert high - low < 2 * (end - begin) + 4
    shown = traces(browser, "RPM Measured, can")
    assert len(shown) == 4
    assert all(low - 1 < trace["x"][0] and trace["x"][-1] < high + 1 for trace in shown if trace["x"])


def pixel(browser, x, y):
    """The colour that is seen at a place of the page."""
    clip = {"x": x, "y": y, "width": 1, "height": 1, "scale": 1}
    shot = browser.execute_cdp_cmd("Page.captureScreenshot", {"clip": clip})
    png = base64.b64decode(shot["data"])
    packed, at = b"", 8
    while at < len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        packed += png[at + 8 : at + 8 + size] if png[at + 4 : at + 8] == b"IDAT" else b""
        at += size + 12
    return tuple(zlib.decompress(packed)[1:4])  # behind the byte that names the first line's filter


def test_times_are_read_by_people_and_count_from_the_captures_begin(example_browser):
    """As tshark's frame.time_relative."""
    (fault,) = [row for row in incidents_of(example_browser) if row["fault"]]
    assert fault["begin"] == pytest.approx(5.6138, abs=1e-9)
    said = example_browser.execute_script("return document.getElementById('verdict').textContent")
    assert said.startswith("NOT GOOD: 1 fault; all decoded")
    causes = causes_of(example_browser)
    assert re.match(
        r"right \(can1\): Motor overcurrent at 0:05\.614, \d\.\d{3} s; then a reboot and silence\.", causes[0]
    ), causes
    silence = next(row for row in incidents_of(example_browser) if row["cells"][0] == "silence")
    assert (silence["begin"], float(silence["end"])) == pytest.approx((7.3138, 7.9138), abs=1e-9)
    assert silence["cells"][4] == "0.600 s"


def test_a_colour_is_a_controller_and_each_value_is_named_once(example_browser):
    draw(example_browser)
    script = (
        """const [query] = arguments; return [...document.querySelectorAll(query)].map(one => one.textContent.trim())"""
    )
    sources = example_browser.execute_script(script, "#sources label")
    assert sorted(sources) == ["can0 0x000", "can1 0x000", "left (can0)", "right (can1)"]
    script_colours = (
        "return [...document.querySelectorAll('#sources i')].map(one => getComputedStyle(one).backgroundColor)"
    )
    colours = dict(zip(sources, example_browser.execute_script(script_colours), strict=True))
    assert colours["left (can0)"] != colours["right (can1)"]
    lines = """return [...document.querySelectorAll(".plot")].flatMap(plot => plot.data).filter(({mode}) => mode === "lines")
        .map(({name, line}) => [name, line.color])"""
    drawn = example_browser.execute_script(lines)
    left = {colour for name, colour in drawn if name.endswith((", left", "can0 0x200")) and "Commanded" not in name}
    assert left == {colours["left (can0)"]}
    assert any(name.endswith("can0 0x200") for name, _ in drawn)
    fields = example_browser.execute_script(script, "figcaption b")
    assert (
        fields.count("Torque IQ Measured, A") == fields.count("RPM Measured, RPM") == fields.count("DC Voltage, V") == 1
    )


def test_one_cursor_tells_all_values_at_its_time(browser, page):
    truth = page[1]
    show(browser, 0, SECONDS)
    script = """const done = arguments[0], pause = (ms) => new Promise((after) => setTimeout(after, ms));
      (async () => {
        const [speed, current] = ["motor.rpm_measured", "motor.dc_current"].map((key) => document.querySelector(`[data-key="${key}"] .plot`));
        speed.scrollIntoView({block: "start"});
        await pause(500);
        const {_offset: left, _length: width} = speed._fullLayout.xaxis, box = speed.getBoundingClientRect();
        const about = {clientX: box.left + left + width / 4, clientY: box.top + 60, bubbles: true};
        speed.querySelector(".nsewdrag").dispatchEvent(new MouseEvent("mousemove", about));
        await pause(800);
        const text = (plot) => plot.querySelector(".hoverlayer").textContent;
        done([document.getElementById("cursor").textContent, text(speed), text(current)]);
      })()"""
    said, speeds, currents = browser.execute_async_script(script)
    at = float(re.search(r"\(([\d.]+) s\)", said)[1])
    assert at == pytest.approx(SECONDS / 4, abs=0.3)
    assert "UTC" in said
    nearest = [
        flights.value(raw, -60000, 60000, 65530)
        for when, bus, number, raw, _, _ in truth.motor
        if (bus, number) == ("can0", 0x210) and raw != flights.NAN16 and abs((when - truth.begin) / 1e9 - at) < 0.26
    ]
    (shown,) = [text.replace(",", "") for text in re.findall(r"can0 0x210 : ([\d,.]+) RPM", speeds)]
    assert min(abs(float(shown) - value) for value in nearest) < 0.06
    assert "can0 0x210" in currents


def test_a_link_leads_to_a_time_and_a_zoom_makes_one(example):
    browser = open_browser(example, width=1200, link="#t=5,8")
    try:
        time.sleep(1)
        assert x_range(browser) == pytest.approx([5, 8])
        show(browser, 6, 7)
        assert browser.execute_script("return location.hash") == "#t=6.000,7.000"
    finally:
        browser.quit()


# ---- eight controllers on two buses: M3 falls silent, M6 has an overcurrent of 0.3 s, M8 gets hot

RULES = "motor.esc_temperature=..80\nmotor.motor_temperature=..200\nmotor.dc_voltage=40..55\nsource=M1\nmotor.dc_current=..60\n"


@pytest.fixture(scope="module")
def eight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("eight")
    truth = flights.write(folder / "flight.pcapng", 23, 300, flights.EIGHT)
    (folder / "flight.rules").write_text(RULES)
    names = ",".join(f"can{n // 4}/{0x210 + n % 4:#x}=motor:M{n + 1}" for n in range(8))
    options = ["-o", f"yapp.sources:{names}", "-o", "yapp.health_ids:0x200-0x203", "--plugin", PLUGIN]
    run_tables(folder, "report", "flight.pcapng", "--out", "page.html", "--rules", "flight.rules", *options, code=0)
    return folder / "page.html", truth


@pytest.fixture(scope="module")
def eight_browser(eight):
    browser = open_browser(eight[0], width=1300)
    yield browser
    browser.quit()


def cells(browser, table):
    """{row heading: {column heading: (text, class)}} of a table."""
    script = """const [head, ...rows] = document.querySelectorAll(`#${arguments[0]} tr`);
      return rows.map(row => [row.cells[0].textContent, [...row.cells].slice(1).map((cell, at) =>
        [head.cells[at + 1].textContent, cell.textContent, cell.className])])"""
    return {
        row: {head: (text, kind) for head, text, kind in found} for row, found in browser.execute_script(script, table)
    }


def test_the_least_margin_is_named_at_the_top(eight):
    """The controller that gets hot went farthest beyond a limit."""
    page = eight[0].read_text()
    margin = r"Least margin: (-[\d.]+) \((-[\d.]+) %\) at the rule motor\.esc_temperature=\.\.80, of M8 in frame \d+\."
    found = re.search(margin, page)
    assert float(found[2]) == pytest.approx(float(found[1]) / 80 * 100, rel=0.01)


def test_a_recorder_that_lost_power(tmp_path):
    """What it wrote until then has a page: its fault, and the least margin of rules, one about all controllers too."""
    (tmp_path / "cut.pcapng").write_bytes((TOP / "docs/flight.pcapng").read_bytes()[:40_000])
    (tmp_path / "own.rules").write_text("motor.dc_voltage.spread=20\n")
    for more in ([], ["--rules", "own.rules"]):
        done = run_tables(tmp_path, "report", "cut.pcapng", "--out", "page.html", *more, "--plugin", PLUGIN)
        assert done.returncode == 1
        assert "cut short" in done.stderr
        page = (tmp_path / "page.html").read_text()
        assert "cut short" in page
        assert "Motor overcurrent" in page
    assert re.search(r"Least margin: [\d.]+ \([\d.]+ %\) at the rule motor\.dc_voltage\.spread=20, of capture", page)


def test_the_first_lines_name_who_what_and_when(eight_browser, eight):
    ((begin, *_),) = eight[1].faults
    said = eight_browser.execute_script("return document.getElementById('verdict').innerText")
    assert said.startswith("NOT GOOD: 1 fault, 1 silence of "), said
    assert "1 controller too hot" in said
    m3, m6, m8 = sorted(causes_of(eight_browser))
    assert re.match(r"M3 \(can0\): silent until the end, from \d+:\d\d\.\d{3}\.", m3)
    clock = f"{int((begin - eight[1].begin) / 60e9)}:"
    assert re.match(
        rf"M6 \(can1\): Motor overcurrent at {clock}[\d.]+, 0\.\d{{3}} s; DC Current 3\d\.\d A, 2\.[4-8] times the others', "
        r"from 0\.[2-4]\d\d s before\.",
        m6,
    ), m6
    assert re.match(r"M8 \(can1\): \w+ Temperature \d+ °C at the end, \d+ above the others", m8), m8
    assert re.search(r"; above 80 °C for 1 min [\d.]+ s from 3:4", m8), m8
    assert re.search(r"; also Motor Temperature \d+ °C hotter \(200 °C \d min \d+ s later\)", m8), m8


def test_the_matrix_shades_who_is_far_from_the_others(eight_browser):
    matrix = cells(eight_browser, "matrix")
    assert list(matrix) == [f"M{n + 1} (can{n // 4})" for n in range(8)]
    far = {(row[:2], head) for row, found in matrix.items() for head, (_, kind) in found.items() if "far" in kind}
    assert ("M6", "DC Current peak, A") in far
    assert ("M6", "Power peak, W") in far
    assert ("M6", "DC Voltage sag, V") in far
    assert ("M6", "Faults") in far
    assert ("M8", "ESC Temperature max, °C") in far
    assert ("M3", "Energy, Wh") in far
    assert ("M3", "Silences") in far
    assert {row for row, _ in far} == {"M3", "M6", "M8"}
    assert not [head for row, head in far if row == "M3" and "mean" in head]  # of a part of the flight
    assert matrix["M1 (can0)"]["Faults"][0] == "0"
    # Incidents count: a fault and its state, Motor Data and Health that fall silent.
    assert matrix["M6 (can1)"]["Faults"][0] == matrix["M3 (can0)"]["Silences"][0] == "▲ 1"


def test_a_click_on_the_matrix_shows_one_controller(eight_browser):
    try:
        eight_browser.execute_script(
            "document.querySelectorAll('#matrix tbody tr button, #matrix tr button')[5].click()"
        )
        shown = {one["name"].rpartition(", ")[2] for one in traces(eight_browser, ", ") if one["visible"]}
        assert shown == {"M6"}
        checked = "return [...document.querySelectorAll('#sources input:checked')].map(one => one.parentNode.textContent.trim())"
        assert eight_browser.execute_script(checked) == ["M6 (can1)"]
        eight_browser.execute_script("document.querySelector('#matrix td[data-figure=\"motor.dc_current\"]').click()")
        top = "return document.querySelector('figure[data-key=\"motor.dc_current\"]').getBoundingClientRect().top"
        assert 0 <= eight_browser.execute_script(top) < 120
    finally:
        eight_browser.execute_script(
            "[...document.querySelectorAll('#sources button')].find(one => one.textContent === 'all').click()"
        )
    assert len({one["name"] for one in traces(eight_browser, "RPM Measured, ") if one["visible"]}) == 8


def test_small_multiples_share_an_axis_and_have_a_row_each(eight_browser):
    """The hottest reaches the top of its column, the others' heat stays where it is in degrees."""
    rows = eight_browser.execute_script(
        """return [...document.querySelectorAll("#multiples tr[data-controller]")].map(row => [row.cells[0].textContent,
        [...row.querySelectorAll("svg")].map(svg => [svg.querySelector("title").textContent, svg.querySelector("path.own").getAttribute("d")])])"""
    )
    assert [name[:2] for name, _ in rows] == [f"M{n + 1}" for n in range(8)]
    heat = {
        name[:2]: dict(found)[next(title for title, _ in found if "ESC Temperature" in title)] for name, found in rows
    }
    lowest_y = {who: min(int(y) for y in re.findall(r"[ML]\d+ (\d+)", path)) for who, path in heat.items()}
    assert lowest_y.pop("M8") == 3  # the top
    assert min(lowest_y.values()) > 80
    for title in ("RPM Measured", "DC Current", "DC Voltage", "Motor Temperature", "ESC Temperature"):
        assert any(title in text for text, _ in rows[0][1]), title
    assert eight_browser.execute_script("return document.querySelectorAll('#multiples rect.band').length") > 0


def test_the_odd_one_is_in_its_cloud(eight_browser):
    draw(eight_browser)
    clouds = eight_browser.execute_script(
        """return [...document.querySelectorAll("#clouds figure")].map(one => [one.querySelector("figcaption").textContent,
          one.querySelector(".plot").data.map(({name, y}) => [name, Math.max(...y)])])"""
    )
    ((text, found),) = clouds
    assert text.partition("Motor Data")[0] == "DC Current over RPM Measured, A"
    assert "odd:" not in text  # of 300 s it was so for 0.6 s
    assert len(found) == 8
    assert {name for name, most in found if most > 20} == {"M6 (can1)"}


def test_no_picture_comes_twice_and_the_first_ones_matter_most(eight_browser):
    keys = eight_browser.execute_script(
        "return [...document.querySelectorAll('#pictures figure')].map(one => one.dataset.key)"
    )
    wanted = ["motor.rpm_measured", "motor.dc_current", "motor.motor_temperature", "motor.dc_voltage"]
    assert keys[:5] == ["wrong", *wanted]
    titles = eight_browser.execute_script(
        "return [...document.querySelectorAll('#pictures figcaption')].map(one => one.textContent)"
    )
    assert len(titles) == len(set(titles))
    assert not [title for title in titles if "less commanded" in title or "below its limit" in title]


def test_limits_are_bands(eight_browser):
    """Between the limit of 80 °C and the top it is reddish, in both themes: colours as they are seen."""
    draw(eight_browser)
    place = """const plot = document.querySelector('figure[data-key="motor.esc_temperature"] .plot');
      plot.scrollIntoView({block: "center"});
      const {top, left} = plot.getBoundingClientRect(), {xaxis, yaxis} = plot._fullLayout;
      return arguments[0].map(value => [left + scrollX + xaxis._offset + 0.03 * xaxis._length,
        top + scrollY + yaxis._offset + yaxis.l2p(value)])"""
    values = [91.0, 65.0]  # between the lines of the grid
    for _ in ("light", "dark"):
        bad, good = (pixel(eight_browser, *map(round, at)) for at in eight_browser.execute_script(place, values))
        paper = eight_browser.execute_script(
            "return getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g).map(Number)"
        )
        assert bad[0] - bad[1] > paper[0] - paper[1] + 8, (bad, paper)
        assert good[1] - good[0] > paper[1] - paper[0] + 8, (good, paper)
        eight_browser.find_element(By.ID, "theme").click()
        time.sleep(1)
        draw(eight_browser)
    written = """const plot = document.querySelector(`figure[data-key="motor.${arguments[0]}"] .plot`);
      return plot.layout.annotations.map(({text}) => text)"""
    assert eight_browser.execute_script(written, "esc_temperature") == ["at most 80 °C"]
    assert eight_browser.execute_script(written, "rpm_measured") == []
    said = "return document.querySelector('figure[data-key=\"motor.dc_voltage\"] figcaption').textContent"
    assert "limit: at least 40 V, at most 55 V" in eight_browser.execute_script(said)


def test_on_paper_nothing_is_cut_and_no_picture_is_split(eight):
    browser = open_browser(eight[0], width=1300)
    try:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": 1062, "height": 750, "deviceScaleFactor": 1, "mobile": False},
        )
        browser.execute_script("dispatchEvent(new Event('beforeprint'))")
        assert browser.execute_script(
            "return document.querySelectorAll('.plot svg').length > 8 && !document.querySelector('.plot[data-stale]')"
        )
        script = """return [...document.querySelectorAll("table, svg, figure, p, li, figcaption > *")].filter(one => one.offsetParent !== null || one.ownerSVGElement === null)
          .map(one => one.getBoundingClientRect().right).reduce((a, b) => Math.max(a, b))"""
        assert browser.execute_script(script) <= 1062
        cut = "return [...document.querySelectorAll('.scroll')].filter(one => one.scrollHeight > one.clientHeight + 1 && getComputedStyle(one).overflow !== 'visible').length"
        assert browser.execute_script(cut) == 0
        whole = "return [...document.querySelectorAll('figure, tr')].every(one => getComputedStyle(one).breakInside === 'avoid')"
        assert browser.execute_script(whole)
        pdf = browser.execute_cdp_cmd("Page.printToPDF", {"landscape": True, "preferCSSPageSize": True})
        assert base64.b64decode(pdf["data"]).count(b"/Type /Page\n") <= 4
    finally:
        browser.quit()
