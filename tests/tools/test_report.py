# SPDX-License-Identifier: GPL-2.0-or-later
"""yapp-tables report: the page of a flight with known truth, in a real headless Chromium."""

import json
import time

import flights
import pytest
from running import PLUGIN, run_tables
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

SECONDS = 120


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    truth = flights.write(folder / "flight.pcapng", 7, SECONDS)
    options = [word for option in flights.OPTIONS for word in ("-o", option)]
    done = run_tables(folder, "report", "flight.pcapng", "-o", "flight.html", *options, "--plugin", PLUGIN)
    assert done.returncode == 0, done.stderr
    return folder / "flight.html", truth


def open_browser(path, phone=False, way="svg"):
    options = webdriver.ChromeOptions()
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--enable-unsafe-swiftshader",
        "--window-size=1300,1000",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    if phone:
        metrics = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get(f"{path.as_uri()}#{way}")
    for _ in range(600):
        if browser.execute_script("return document.documentElement.dataset.ready"):
            return browser
        time.sleep(0.1)
    raise AssertionError(browser.get_log("browser"))


@pytest.fixture(scope="module", params=["svg", "webgl"])
def browser(page, request):
    browser = open_browser(page[0], way=request.param)
    yield browser
    browser.quit()


def in_seconds(text):
    minutes, seconds = text.split(":")
    return int(minutes) * 60 + float(seconds)


def rows_of(browser, table):
    """A table's rows as {heading: text}."""
    cells = "[...row.cells].map(cell => cell.textContent)"
    script = f"return [...document.querySelectorAll(arguments[0])].map(row => {cells})"
    head, *rows = browser.execute_script(script, f"#{table} tr")
    return [dict(zip(head, row, strict=True)) for row in rows]


def traces(browser, name, mode="lines"):
    """x and y of the traces whose name has this in it; None where there is no value."""
    script = """const [name, mode] = arguments;
      return document.getElementById("plot").data.filter(trace => trace.name.includes(name) && trace.mode === mode)
        .map(trace => ({x: Array.from(trace.x), y: Array.from(trace.y, y => Number.isNaN(y) ? null : y)}))"""
    return browser.execute_script(script, name, mode)


def x_range(browser):
    return browser.execute_script("return document.getElementById('plot')._fullLayout.xaxis.range.map(Number)")


def show(browser, begin, end):
    """Zoom, and wait until the samples have followed."""
    browser.execute_async_script(
        """const done = arguments[2]; Plotly.relayout("plot", {"xaxis.range": [arguments[0], arguments[1]]})
        .then(() => setTimeout(done, 1500))""",
        begin,
        end,
    )


def test_it_opens_without_an_error_and_asks_the_network_for_nothing(browser, page):
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []
    messages = (json.loads(line["message"])["message"] for line in browser.get_log("performance"))
    asked = [
        message["params"]["request"]["url"] for message in messages if message["method"] == "Network.requestWillBeSent"
    ]
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {page[0].as_uri()}


def test_the_fault_table_has_the_truths_rows(browser, page):
    truth = page[1]
    first = min(row[0] for row in truth.motor) - 1_400_000
    rows = rows_of(browser, "faults")
    assert len(rows) == len(truth.faults) == 2
    for row, (begin, end, bus, number, flag) in zip(rows, truth.faults, strict=True):
        assert in_seconds(row["begin"]) == pytest.approx((begin - first) / 1e9, abs=0.01)
        if end is None:
            assert row["end"] == "still active"
        else:
            assert in_seconds(row["end"]) == pytest.approx((end - first) / 1e9, abs=0.01)
            assert float(row["duration/s"]) == pytest.approx((end - begin) / 1e9, abs=0.002)
        assert row["source"] == f"{bus} 0x{number:03x}"
        assert row["what"].lower().replace(" ", "_").startswith(flag)


def test_the_other_events_are_the_truths(browser, page):
    truth = page[1]
    motor = [row for row in rows_of(browser, "others") if row["message"] == "Motor Data"]
    assert sum(row["what"] == "reboot" for row in motor) == len(truth.reboots)
    assert sum(row["what"] == "silence" for row in motor) == len(truth.silences)
    assert sum(int(row["count"]) for row in motor if row["what"] == "lost frames") == len(truth.incomplete)


def test_a_click_on_a_fault_zooms_to_it_on_all_axes(browser):
    row = browser.find_elements(By.CSS_SELECTOR, "#faults tbody tr")[0]
    first = rows_of(browser, "faults")[0]
    begin, end = (in_seconds(first[key]) if ":" in first[key] else SECONDS for key in ("begin", "end"))
    row.click()
    time.sleep(1.5)
    low, high = x_range(browser)
    assert low < begin < end <= high + 1
    assert high - low < 2 * (end - begin) + 4
    shown = traces(browser, "RPM Measured, can")
    assert len(shown) == 4
    assert all(low - 1 < trace["x"][0] and trace["x"][-1] < high + 1 for trace in shown if trace["x"])


def test_gaps_are_gaps_and_reserved_counts_are_marks(browser, page):
    truth = page[1]
    show(browser, 0, SECONDS)
    (line,) = traces(browser, "RPM Measured, can1 0x210")
    (silence,) = [row for row in truth.silences if row[3] > 1e9]
    begin = (silence[0] - flights.START) / 1e9
    inside = [
        y for x, y in zip(line["x"], line["y"], strict=True) if begin + 0.05 < x < begin + silence[3] / 1e9 - 0.05
    ]
    assert inside == [None]
    (marks,) = traces(browser, "ESC Temperature, can1 0x211", "markers")
    expected = [row for row in truth.motor if row[1:3] == ("can1", 0x211) and row[4] in (flights.NAN8, flights.ABOVE8)]
    assert len(marks["x"]) == len(expected)


def test_thinning_keeps_extremes(browser, page):
    truth = page[1]
    raws = [row[3] for row in truth.motor if row[1:3] == ("can0", 0x210) and row[3] != flights.NAN16]
    show(browser, 0, SECONDS)
    (line,) = traces(browser, "RPM Measured, can0 0x210")
    drawn = [value for value in line["y"] if value is not None]
    assert max(drawn) == pytest.approx(flights.value(max(raws), -60000, 60000, 65530), abs=0.01)
    assert min(drawn) == pytest.approx(flights.value(min(raws), -60000, 60000, 65530), abs=0.01)


def test_light_and_dark(browser):
    script = "return getComputedStyle(document.body).backgroundColor"
    before = browser.execute_script(script)
    browser.find_element(By.ID, "theme").click()
    time.sleep(1)
    assert browser.execute_script(script) != before
    assert browser.execute_script("return document.getElementById('plot').layout.paper_bgcolor") != before


def test_states_and_flags_are_bars(browser, page):
    script = """const all = document.getElementById("plot").data;
      return all.filter(trace => trace.type === "bar" && trace.name === arguments[0])
        .map(({base, x, text}) => base.map((begin, i) => [begin, begin + x[i], text[i] ?? null]))"""
    (mode,) = browser.execute_script(script, "Motor Mode, can0 0x210")
    assert {text for _, _, text in mode} == {"Speed Mode"}
    ((begin, end, bus, number, _),) = [row for row in page[1].faults if row[4] == "motor_overcurrent"]
    (((low, high, text),),) = browser.execute_script(script, f"Motor overcurrent, {bus} 0x{number:03x}")
    first = min(row[0] for row in page[1].motor) - 1_400_000
    assert (low, high) == pytest.approx(((begin - first) / 1e9, (end - first) / 1e9), abs=0.01)
    assert text is None


def test_printed_it_fits_the_paper_and_is_light(browser):
    script = """const plot = document.getElementById("plot"), style = getComputedStyle(document.body);
      return [plot._fullLayout.width, plot.layout.paper_bgcolor, style.backgroundColor]"""
    browser.execute_script("document.documentElement.dataset.theme = 'dark'; dispatchEvent(new Event('beforeprint'))")
    time.sleep(1)
    assert browser.execute_script(script) == [700, "rgb(255, 255, 255)", "rgb(255, 255, 255)"]
    browser.execute_script("dispatchEvent(new Event('afterprint'))")
    time.sleep(1)
    width, *colours = browser.execute_script(script)
    assert width > 1000
    assert colours == ["rgb(20, 23, 26)"] * 2


def test_it_fits_a_phone(page):
    phone = open_browser(page[0], phone=True)
    try:
        texts = "return [...document.querySelectorAll('.annotation')].map(text => text.getBoundingClientRect().right)"
        assert max(phone.execute_script(texts)) <= 390
        wide, window = phone.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert wide <= window == 390
        assert phone.execute_script("return document.getElementById('plot')._fullLayout.width") <= window
    finally:
        phone.quit()


def test_without_plotly_the_error_names_the_command(tmp_path):
    (tmp_path / "plotly.py").write_text("raise ImportError('not here')")
    done = run_tables(tmp_path, "report", "flight.pcapng")
    assert done.returncode == 2
    assert "pip install 'yapp-tables[report]'" in done.stderr
