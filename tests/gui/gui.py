# SPDX-License-Identifier: GPL-2.0-or-later
"""Runs the real Wireshark on a display of its own, under Xvfb, and sees its windows."""
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import tshark  # noqa: E402

FLIGHT = ROOT / "docs/flight.pcapng"  # two controllers; see test_captures/flight.py

NEEDED = ("wireshark", "Xvfb", "openbox", "xdotool", "xclip", "tesseract", "convert", "import")
MISSING = [name for name in NEEDED if not shutil.which(name)]
WIDTH, HEIGHT = 1200, 740

# No questions, and the columns that matter here; packet list over tree, no bytes.
PREFERENCES = r"""
gui.ask_unsaved: FALSE
gui.update.enabled: FALSE
gui.layout_type: 1
gui.layout_content_1: PLIST
gui.layout_content_2: PDETAILS
gui.layout_content_3: NONE
gui.column.format: "No.", "%m", "Time", "%t", "Protocol", "%p", "Info", "%i"
"""
RECENT = f"""
gui.geometry_main_x: 0
gui.geometry_main_y: 0
gui.geometry_main_width: {WIDTH}
gui.geometry_main_height: {HEIGHT}
gui.geometry_main_maximized: TRUE
"""
PROFILE_RECENT = """
gui.toolbar_main_show: FALSE
gui.geometry_main_upper_pane: 180
column.width: %m, 60, %t, 90, %p, 80, %i, 780
"""


def wait_for(condition, seconds=120):
    """The first true value that condition gives; fails when there is none in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.2)
    raise AssertionError(f"not in {seconds} seconds")


class Wireshark:
    """with Wireshark(arguments) as wireshark: a running Wireshark, with the plugin loaded by the route of the tests."""

    def __init__(self, *arguments, plugin=tshark.PLUGIN, route=tshark.ROUTE, profile=None, recent=""):
        """profile: a folder; it is there, beside the default one, which is used unless the arguments say otherwise; recent:
        what Wireshark remembers of it besides"""
        self.arguments, self.processes = list(map(str, arguments)), []
        self.home = pathlib.Path(tempfile.mkdtemp(prefix="yapp-gui-"))
        installed = self.home / ".local/lib/wireshark/plugins/yapp"
        self.plugin = place = installed if route == "plugin" else self.home / "script"
        (tshark.install_plugin if route == "plugin" else tshark.copy_plugin)(place, plugin)
        if route == "script":
            self.arguments = ["-X", f"lua_script:{place / 'yapp.lua'}", *self.arguments]
        config = self.home / ".config/wireshark"
        config.mkdir(parents=True)
        (config / "preferences").write_text(PREFERENCES)
        (config / "recent").write_text(PROFILE_RECENT)
        (config / "recent_common").write_text(RECENT)
        if profile:
            shutil.copytree(profile, config / "profiles" / profile.name)
            with open(config / "profiles" / profile.name / "recent", "a", encoding="utf-8") as file:
                file.write("gui.toolbar_main_show: FALSE\n" + recent)
        self.stderr_path, self.front = self.home / "stderr", None  # the window that was last brought to the front
        self.user = {"user": 65534, "group": 65534, "extra_groups": []} if os.geteuid() == 0 else {}
        if self.user:
            for path in [self.home, *self.home.rglob("*")]:
                os.chown(path, 65534, 65534)

    def start(self, command, **options):
        process = subprocess.Popen(command, env=self.environment, stdin=subprocess.DEVNULL, **options)
        self.processes.append(process)
        return process

    def __enter__(self):
        self.environment = {**os.environ, "HOME": str(self.home), "XDG_RUNTIME_DIR": str(self.home),
                            "QT_QPA_PLATFORM": "xcb", "LC_ALL": "C.UTF-8"}
        self.environment.pop("XDG_CONFIG_HOME", None)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        read, write = os.pipe()
        self.start(["Xvfb", "-displayfd", str(write), "-ac", "-nolisten", "tcp", "-nolisten", "local", "-screen", "0",
                    f"{WIDTH}x{HEIGHT}x24"], pass_fds=[write], **quiet)
        os.close(write)
        with os.fdopen(read) as display:
            self.environment["DISPLAY"] = ":" + display.readline().strip()
        self.start(["openbox"], **quiet)
        with open(self.stderr_path, "wb") as stderr:
            self.wireshark = self.start(["wireshark", *self.arguments], stderr=stderr, stdout=stderr, **self.user)
        return self

    def __exit__(self, *_):
        for process in reversed(self.processes):
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        shutil.rmtree(self.home, ignore_errors=True)

    def xdotool(self, *words):
        done = subprocess.run(["xdotool", *map(str, words)], env=self.environment, capture_output=True, text=True,
                              check=False, timeout=60)
        return done.stdout.split("\n")[:-1]

    def windows(self):
        """The visible windows: { id: title }.  Searched by class: a search by name does not find message boxes."""
        titles = {window: " ".join(self.xdotool("getwindowname", window))
                  for window in self.xdotool("search", "--onlyvisible", "--class", ".")}
        return {window: title for window, title in titles.items() if title != "Openbox"}

    def wait_for_window(self, part, whole=False):
        """Waits for a window with this in its title, or as its whole title; brings it to the front, and gives what moves
        inside it time."""
        def found():
            assert self.wireshark.poll() is None, f"Wireshark ended: {self.stderr()}"
            titles = {window: title for window, title in self.windows().items() if (title == part if whole else part in title)}
            return min(titles, key=lambda window: len(titles[window]), default=None)  # YAPP Fault, not YAPP Faults
        try:
            window = wait_for(found)
        except AssertionError as error:
            raise AssertionError(f"no window {part!r}: {self.windows()}\n{self.stderr()}") from error
        self.xdotool("windowactivate", "--sync", window)
        self.front = window
        time.sleep(2)
        return window

    def keys(self, *keys):
        for key in keys:
            self.xdotool("key", "--clearmodifiers", key)
            time.sleep(0.15)

    def type(self, text):
        self.xdotool("type", "--delay", 20, text)

    def answer(self, title, text, before="ctrl+a"):
        """Types into a dialog with one line, and presses its button.  before: a key that says what happens to its text."""
        dialog = self.wait_for_window(title)
        self.xdotool("mousemove", "--window", dialog, 250, 25, "click", "1")  # the focus is on OK
        self.keys(before)
        self.type(text)
        self.keys("Return")
        wait_for(lambda: dialog not in self.windows())

    def filter(self, text):
        self.keys("ctrl+slash", "ctrl+a")
        self.type(text)
        self.keys("Return")
        time.sleep(1)

    def press(self, *keys, until, menu_of=None):
        """Presses keys until something has come of it: a busy Wireshark may pass over some, and leave a menu open, or the
        window may have lost the focus.  Each attempt waits longer, as the next one begins with Escape, which closes what a
        busy machine shows late.
        menu_of: (x, y), where a right click opens the menu for the keys"""
        for attempt in range(4):
            if attempt:
                self.keys(*["Escape"] * 3)
                self.xdotool("windowactivate", "--sync", self.front)
            if menu_of:
                self.xdotool("mousemove", *menu_of, "click", "3")
                time.sleep(1)
            self.keys(*keys)
            try:
                return wait_for(until, 20 * (attempt + 1))
            except AssertionError:
                pass
        raise AssertionError(f"nothing came of {keys}: {self.windows()}, exit code {self.wireshark.poll()}\n{self.stderr()}")

    def clipboard(self, *words):
        """What the clipboard has; with -i: empties it."""
        try:
            done = subprocess.run(["xclip", "-selection", "clipboard", *(words or ["-o"])], env=self.environment,
                                  stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False, timeout=10,
                                  stdout=subprocess.DEVNULL if words else subprocess.PIPE)
        except subprocess.TimeoutExpired:
            return ""
        return (done.stdout or b"").decode("utf-8", "replace")

    def tree(self, *parts, seconds=120):
        """Waits for a packet with all these in the lines that its tree shows."""
        shown = []

        def found():
            self.clipboard("-i")
            self.keys("ctrl+alt+shift+a")  # Copy, All Visible Items
            shown[:] = self.clipboard().splitlines()
            return all(any(part in line for line in shown) for part in parts)
        try:
            wait_for(found, seconds)
        except AssertionError as error:
            raise AssertionError(f"no tree with {parts}: {shown}") from error

    def stderr(self):
        return self.stderr_path.read_text(errors="replace")

    def read(self, area="", scale=300):
        """The words that can be read in an area of the screen, WxH+X+Y: [(word, left, top, width, height)], the places in
        parts of the area."""
        path = self.home / "words.png"
        self.picture(path)
        crop = ["-crop", area, "+repage"] if area else []
        subprocess.run(["convert", path, *crop, "-colorspace", "gray", "-scale", f"{scale}%", path], check=True)
        done = subprocess.run(["tesseract", path, "-", "--psm", "11", "tsv"], capture_output=True, text=True, check=True)
        lines = [line.split("\t") for line in done.stdout.splitlines()[1:]]
        return [(line[11], *(int(cell) * 100 // scale for cell in line[6:10])) for line in lines if line[11].strip()]

    def words(self, area="", scale=300):
        """The words of an area in one text."""
        return " ".join(word for word, *_ in self.read(area, scale))

    def click(self, word):
        """Clicks on the lowest place where this word can be read: a button of a window's."""
        def found():
            return [place for text, *place in self.read(scale=200) if text == word]
        left, top, width, height = max(wait_for(found), key=lambda place: place[1])
        self.xdotool("mousemove", left + width // 2, top + height // 2, "click", "1")
        time.sleep(1)

    def pixels(self, colour):
        """How many pixels of the screen have a colour, #rrggbb."""
        path = self.home / "pixels.png"
        self.picture(path)
        done = subprocess.run(["convert", path, "-fill", "black", "+opaque", colour, "-fill", "white", "-opaque", colour,
                               "-format", "%[fx:mean*w*h]", "info:"], capture_output=True, text=True, check=True)
        return round(float(done.stdout))

    def picture(self, path, area="", window="root"):
        """A picture of the screen, of an area of it, WxH+X+Y, or of a window."""
        crop = ["-crop", area, "+repage"] if area else []
        subprocess.run(["import", "-window", window, *crop, path], env=self.environment, check=True)
