"""A headless Chromium for the page's tests; without one (or its driver, or selenium) they skip."""

import shutil
import signal
import sys
import time
from pathlib import Path

import pytest
from support.waiting import PATIENCE_S

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"


def missing():
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "python3-selenium is not installed"
    for program in (CHROMIUM, DRIVER):
        if not shutil.which(program):
            return f"{program} is not installed"
    return None


class Page:
    """What a person does with the page, in a few verbs."""

    def __init__(self, driver):
        self.driver = driver

    def open(self, url):
        self.driver.get("about:blank")
        self.driver.get(url)

    def path(self):
        """The camera path that the page keeps."""
        return self.run("""
return JSON.parse(Object.entries(sessionStorage).find(([k]) => k.startsWith('ripnerf-path'))[1]);""")

    def all(self, css):
        return self.driver.find_elements("css selector", css)

    def until(self, what, describe, wait_s=PATIENCE_S):
        """The first true value of what(), polled; stale elements are looked for again."""
        from selenium.common.exceptions import StaleElementReferenceException

        end = time.monotonic() + wait_s
        while True:
            try:
                value = what()
            except StaleElementReferenceException:
                value = None
            if value:
                return value
            if time.monotonic() > end:
                pytest.fail(
                    f"waited {wait_s} s for {describe}\nthe page says:\n{self.text('body')[:3000]}\n{self.complaints()}"
                )
            time.sleep(0.05)

    def find(self, css, wait_s=PATIENCE_S):
        return self.until(
            lambda: next((e for e in self.all(css) if e.is_displayed()), None), css, wait_s
        )

    def text(self, css):
        elements = self.all(css)
        return elements[0].text if elements else ""

    def says(self, words, css="main", wait_s=PATIENCE_S):
        return self.until(
            lambda: any(words in e.text for e in self.all(css)), f"{words!r} in {css}", wait_s
        )

    def button(self, words, wait_s=PATIENCE_S):
        def look():
            return next(
                (
                    e
                    for e in self.all("button, a.button, label.button, summary, .segments label")
                    if e.text.strip() == words and e.is_displayed() and e.is_enabled()
                ),
                None,
            )

        return self.until(look, f"a button {words!r}", wait_s)

    def press(self, words):
        element = self.button(words)
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
        self.until(lambda: self.rests(element), f"the button {words!r} to stand still")
        element.click()

    def double_click(self, element, right, down):
        """So far from its middle; said to be a double click, however slowly its parts come."""
        x, y = self.driver.execute_script(
            "arguments[0].scrollIntoView({block: 'center'});"
            "const r = arguments[0].getBoundingClientRect();"
            "return [r.left + r.width / 2, r.top + r.height / 2];",
            element,
        )
        for count in (1, 2):
            for part in ("mousePressed", "mouseReleased"):
                where = {"x": x + right, "y": y + down, "button": "left", "clickCount": count}
                self.driver.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": part, **where})

    def rests(self, element):
        """Whether it stays where it is for two frames."""
        return self.driver.execute_async_script(
            "const [element, done] = arguments; const top = () => element.getBoundingClientRect().top;"
            "const was = top();"
            "requestAnimationFrame(() => requestAnimationFrame(() => done(top() === was)));",
            element,
        )

    def type(self, element, words):
        element.clear()
        element.send_keys(str(words))

    def field(self, label, within="main"):
        """The visible control that carries this label."""

        def look():
            return next(
                (
                    self.driver.find_element("id", e.get_attribute("for"))
                    for e in self.all(f"{within} label")
                    if e.text == label and e.is_displayed() and e.get_attribute("for")
                ),
                None,
            )

        return self.until(look, f"a field {label!r}")

    def run(self, body, *args):
        """Runs an async function's body in the page; `load(file)` imports a module of web/js."""
        result = self.driver.execute_async_script(
            "const done = arguments[arguments.length - 1];"
            "const load = (file) => import(new URL('web/js/' + file, document.baseURI).href);"
            f"(async (...args) => {{ {body} }})(...[...arguments].slice(0, -1))"
            ".then((value) => done({value}), (error) => done({error: String(error.stack)}));",
            *args,
        )
        assert "error" not in result, result["error"]
        return result["value"]

    def complaints(self):
        """Errors that the browser logged, such as a script's or of the content security policy."""
        return [
            entry["message"]
            for entry in self.driver.get_log("browser")
            if entry["level"] == "SEVERE" and "Failed to load resource" not in entry["message"]
        ]

    def watch_levels(self):
        """A function that returns how fine the pictures were that the view showed from now on."""
        self.run(
            "const stage = document.querySelector('.stage'); window.shownLevels = [];"
            "const note = () => window.shownLevels.push(stage.dataset.level);"
            "new MutationObserver(note).observe(stage, { attributeFilter: ['data-level'] });"
        )
        return lambda: self.run("return window.shownLevels;")

    def ink(self, css="canvas.picture"):
        """Whether a canvas shows something: the spread of its pixels, 0 when all are equal."""
        return self.driver.execute_script(
            "const c = document.querySelector(arguments[0]);"
            "if (!c || !c.width) return 0;"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "let low = 255, high = 0;"
            "for (let i = 0; i < d.length; i += 64) { low = Math.min(low, d[i]); high = Math.max(high, d[i]); }"
            "return high - low;",
            css,
        )


class Downloads:
    """The folder that the browser saves into."""

    def __init__(self, folder):
        self.folder = folder

    def clear(self):
        for old in self.folder.iterdir():
            old.unlink()

    def saved(self, page, pattern):
        """The file of that name once it is whole: Chromium reserves the name with an empty file,
        writes to another and renames that."""

        def whole():
            if list(self.folder.glob("*.crdownload")):
                return None
            return next((f for f in self.folder.glob(pattern) if f.stat().st_size), None)

        return page.until(whole, f"a saved {pattern}")


@pytest.fixture(scope="session")
def downloads(tmp_path_factory):
    return Downloads(tmp_path_factory.mktemp("downloads"))


@pytest.fixture(scope="session")
def driver(tmp_path_factory, downloads):
    why = missing()
    if why:
        pytest.skip(why)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--no-first-run",
        "--window-size=1440,1000",
        f"--user-data-dir={tmp_path_factory.mktemp('profile')}",
    ):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(service=webdriver.chrome.service.Service(DRIVER), options=options)
    chrome.set_script_timeout(PATIENCE_S)
    chrome.execute_cdp_cmd(
        "Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(downloads.folder)}
    )
    yield chrome
    chrome.quit()


@pytest.fixture
def page(driver):
    """A tab of its own: what a tab remembers is of its address, and ports come again."""
    first = driver.current_window_handle
    driver.switch_to.new_window("tab")
    driver.execute_cdp_cmd("Emulation.setFocusEmulationEnabled", {"enabled": True})
    driver.get_log("browser")
    yield Page(driver)
    driver.execute_cdp_cmd("Network.clearBrowserCache", {})
    driver.close()
    driver.switch_to.window(first)


@pytest.fixture
def fake():
    """fake(scenario) starts a stand-in for the daemon; all are stopped at the end."""
    from fake_api import FakeApi

    started = []

    def start(scenario, port=0):
        started.append(FakeApi(port, scenario))
        return started[-1]

    yield start
    for api in started:
        if not api.stopping:
            api.stop()


@pytest.fixture
def daemon(build, tmp_path):
    """daemon(runner, environment, **options) starts a ripnerfd; all are stopped at the end."""
    from live_daemon import Daemon

    started = []

    def start(runner=None, environment=None, **options):
        started.append(Daemon(build, tmp_path / "data", runner, environment, **options))
        return started[-1]

    yield start
    for one in started:
        assert one.stop() in (0, -signal.SIGKILL), one.log.read_text(encoding="utf-8")[-4000:]


@pytest.fixture
def scene(page, fake):
    """The page of a scene whose picture has come; `api` is the daemon behind it."""
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    page.api = api
    return page
