#!/usr/bin/python3
"""How quick the page is, in a real browser beside a daemon of its own.

    tests/bench/page.py BUILD DATASET [--train 60] [--drag 8] [--rounds 3] [--memory 60]

DATASET, a folder that the daemon reads, is imported and trained by `standard` for `--train` seconds.
A 640x480 view of it is then dragged at 60 movements a second: at rest, and while another training
runs. A line each: pictures a second, milliseconds from an input to the picture of it (median and 95th
percentile; of these, waiting, rendering and encoding in the daemon; and the input's age when it is sent,
its way to the daemon and back, decoding and drawing), pixels of the pictures, how near they are to their
own full picture (PSNR of some three dozen: the least, the tenth percentile, the median), and milliseconds
from the last input to the refined picture. Before that the first and the refined picture of a page that is
opened anew; after it the page's memory before and after `--memory` seconds of dragging and of going to the
other views and back, collected.
"""

import argparse
import io
import json
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy
from PIL import Image
from selenium import webdriver

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS / "browser"), str(TESTS)]
from conftest import CHROMIUM, DRIVER, Page  # noqa: E402
from live_daemon import Daemon  # noqa: E402

SIZE = 640, 480
COMPARED = 36  # pictures of a drag, about, beside their own full ones
# Follows an input through its request, blob and bitmap to the canvas.
WATCH = """
window.pictures = []; window.lastInput = performance.now(); let answer = null;
for (const type of ['pointerrawupdate', 'pointermove'])
  addEventListener(type, (e) => { window.lastInput = e.timeStamp; }, true);
const ask = window.fetch;
window.fetch = async (url, what) => {
  const input = window.lastInput;
  const sent = performance.now();
  const response = await ask(url, what);
  if (String(url).endsWith('/render')) {
    const spent = response.headers.get('Server-Timing') ?? '';
    const part = (name) => Number(new RegExp(`${name};dur=([0-9.]+)`).exec(spent)?.[1]);
    const daemon = ['queue', 'render', 'encode'].map(part);
    for (const kind of ['blob', 'arrayBuffer']) {
      const read = response[kind].bind(response);
      response[kind] = async () => {
        const bytes = await read();
        answer = {input, daemon, asked: what.body, way: [sent - input, performance.now() - sent]};
        return bytes;
      };
    }
  }
  return response;
};
const decode = window.createImageBitmap;
window.createImageBitmap = async (blob, ...more) => {
  const of = Object.assign(blob, answer);
  return Object.assign(await decode(blob, ...more), {of});
};
const draw = CanvasRenderingContext2D.prototype.drawImage;
CanvasRenderingContext2D.prototype.drawImage = function (picture, ...more) {
  draw.call(this, picture, ...more);
  if (this.canvas.matches('.picture') && picture.of?.asked)
    window.pictures.push({at: performance.now(), input: picture.of.input, blob: picture.of,
        asked: picture.of.asked, daemon: picture.of.daemon, way: picture.of.way,
        pixels: picture.width * picture.height});
};
"""
# Pictures of the whole drag but for its first second, as data addresses, for comparison.
KEPT = """
const done = arguments[arguments.length - 1];
const read = (blob) => new Promise((yes) => {
  const reader = new FileReader(); reader.onload = () => yes(reader.result); reader.readAsDataURL(blob);
});
const moving = window.pictures.filter(
    (p) => p.at > window.pictures[0].at + 1000 && JSON.parse(p.asked).format === 'jpeg');
const some = moving.filter((_, i) => i % Math.ceil(moving.length / arguments[0]) === 0);
Promise.all(some.map(async (p) => [p.asked, await read(p.blob)])).then(done);
"""


def call(url, body=None):
    data = json.dumps(body).encode() if body is not None else None
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request) as reply:
        return reply.read()


def finished(server, job):
    while True:
        record = json.loads(call(f"{server}v1/jobs/{job}"))
        if record["state"] in ("succeeded", "failed", "cancelled"):
            assert record["state"] == "succeeded", record
            return record
        time.sleep(0.2)


def train(server, scene, seconds):
    body = {"type": "train", "dataset": "data", "scene": scene,
            "options": {"preset": "standard", "max_time_s": seconds}}
    return json.loads(call(f"{server}v1/jobs", body))["id"]


def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                 "--window-size=1440,1100", "--enable-precise-memory-info"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(service=webdriver.chrome.service.Service(DRIVER), options=options)
    driver.set_script_timeout(60)
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": WATCH})
    return Page(driver)


def opened(page, server, scene):
    """The scene's page at 640x480; milliseconds to its first and to its refined picture."""
    page.open(f"{server}#/scene/{scene}")
    page.until(lambda: page.driver.execute_script("return window.pictures?.length;"), "a picture", 60)
    first = page.driver.execute_script("return window.pictures[0].at;")
    page.find(".stage[data-level=refined]", 60)
    refined = page.driver.execute_script("return window.pictures.at(-1).at;")
    page.driver.execute_script(
        "const s = document.querySelector('.stage').style; s.width = '642px'; s.height = '482px';")
    time.sleep(1)
    page.find(".stage[data-level=refined]", 60)
    return first, refined


def shows(page, sign):
    """Waits in the page: the driver holds on to elements that it finds, and with them to their view."""
    page.until(lambda: page.run("return Boolean(document.querySelector(args[0]));", sign), sign, 60)


def drag(page, seconds):
    """Drags to and fro, 60 movements a second."""
    box = page.driver.execute_script(
        "const b = document.querySelector('.stage').getBoundingClientRect(); return [b.x, b.y];")
    x, y = box[0] + 200, box[1] + 240

    def mouse(kind, at, buttons):
        page.driver.execute_cdp_cmd("Input.dispatchMouseEvent", {
            "type": kind, "x": at, "y": y, "button": "left", "buttons": buttons, "clickCount": 1})

    page.driver.execute_script("window.pictures = [];")
    began, step = time.perf_counter(), 0
    mouse("mousePressed", x, 1)
    while (now := time.perf_counter() - began) < seconds:
        step += 1
        mouse("mouseMoved", x + abs(step * 2 % 400 - 200), 1)
        time.sleep(max(0, step / 60 - now))
    mouse("mouseReleased", x, 0)
    shows(page, ".stage[data-level=refined]")


def psnr(server, scene, asked, address):
    """Of a picture as it was shown beside the same camera's full picture."""
    body = json.loads(asked)
    small = Image.open(io.BytesIO(urllib.request.urlopen(address).read())).convert("RGB")
    camera = {**body["camera"], "width": SIZE[0], "height": SIZE[1]}
    full = call(f"{server}v1/scenes/{scene}/render", {"camera": camera, "format": "png"})
    truth = numpy.asarray(Image.open(io.BytesIO(full)).convert("RGB"), float)
    shown = numpy.asarray(small.resize(SIZE, Image.BILINEAR), float)  # as a canvas does
    return 10 * numpy.log10(255 ** 2 / max(1e-9, numpy.mean((shown - truth) ** 2)))


def measure(page, server, scene, seconds, what):
    drag(page, seconds)
    shown = page.driver.execute_script(
        "return window.pictures.map(({blob, ...rest}) => rest);")
    last = page.driver.execute_script("return window.lastInput;")
    moving = [p for p in shown if json.loads(p["asked"])["format"] == "jpeg" and p["at"] < last]
    refined = next(p["at"] for p in shown[::-1])
    waits = [p["at"] - p["input"] for p in moving]
    daemon = numpy.median([p["daemon"] for p in moving], axis=0)
    ways = numpy.array([[*p["way"], wait - sum(p["way"])] for p, wait in zip(moving, waits)])
    near = [psnr(server, scene, *kept) for kept in page.driver.execute_async_script(KEPT, COMPARED)]
    print(f"{what:16}{len(moving) / seconds:6.1f}/s{numpy.median(waits):8.0f}"
          f"{numpy.percentile(waits, 95):6.0f} ms"
          f" ({daemon[0]:.0f} + {daemon[1]:.0f} + {daemon[2]:.0f};"
          f" {' + '.join(f'{m:.0f}' for m in numpy.median(ways, axis=0))}, at the 95th"
          f" {', '.join(f'{m:.0f}' for m in numpy.percentile(ways, 95, axis=0))})"
          f"{numpy.median([p['pixels'] for p in moving]):9.0f} px"
          f"{min(near):7.1f}{numpy.percentile(near, 10):6.1f}{numpy.median(near):6.1f} dB{refined - last:8.0f} ms refined", flush=True)


def renderer_mib(page):
    """Resident memory of the largest process that draws pages, MiB."""
    parents, sizes = {}, {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if b"--type=renderer" in (entry / "cmdline").read_bytes():
                sizes[int(entry.name)] = int((entry / "statm").read_text().split()[1]) / 256
        except OSError:
            pass  # it has ended meanwhile

    def ours(process):
        while process and process != page.driver.service.process.pid:
            process = parents.get(process)
        return bool(process)
    return max(size for process, size in sizes.items() if ours(process))


def memory(page):
    """What the page holds once all that can go is gone, in words."""
    page.driver.execute_script("window.pictures = [];")
    page.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    page.driver.execute_cdp_cmd("Performance.enable", {})
    found = page.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    figures = {item["name"]: item["value"] for item in found}
    return (f"{figures['JSHeapUsedSize'] / 2 ** 20:.2f} MiB of JavaScript, {figures['Nodes']:.0f} nodes, "
            f"{figures['JSEventListeners']:.0f} listeners, {renderer_mib(page):.0f} MiB resident")


def use(page, scene, seconds):
    """Drags, and looks at the other views and back, for so long; how often the scene was opened."""
    end, rounds = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        drag(page, 5)
        for place, sign in (("jobs", ".job-row"), ("system", ".facts"), ("", ".card"),
                            (f"scene/{scene}", ".stage[data-level=refined]")):
            page.run("location.hash = args[0];", f"#/{place}")
            shows(page, sign)
        page.driver.execute_script("window.pictures = [];")
        rounds += 1
    return rounds


def main():
    about = __doc__.split("\n", maxsplit=1)[0]
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("build", type=Path)
    parser.add_argument("dataset", type=Path)
    for name, default in (("train", 60), ("drag", 8), ("rounds", 3), ("memory", 60)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = str(options.dataset.resolve().parent)
        daemon = Daemon(options.build, Path(folder) / "data", None,
                        options=("--dataset-root", root, "--curve-after", "0"))
        server = daemon.url
        body = {"name": "data", "directory": str(options.dataset.resolve())}
        finished(server, json.loads(call(f"{server}v1/datasets", body))["id"])
        finished(server, train(server, "still", options.train))
        page = browser()
        try:
            first, refined = opened(page, server, "still")
            print(f"opened           {first:.0f} ms first picture, {refined:.0f} ms refined")
            for _ in range(options.rounds):
                measure(page, server, "still", options.drag, "at rest")
            if options.memory:
                use(page, "still", 1)
                print(f"memory           {memory(page)}")
                rounds = use(page, "still", options.memory)
                print(f"after {rounds:3} openings {memory(page)}", flush=True)
            train(server, "moving", 600)
            page.open("about:blank")
            opened(page, server, "moving")
            time.sleep(15)
            for _ in range(options.rounds):
                measure(page, server, "moving", options.drag, "while training")
        finally:
            page.driver.quit()
            daemon.stop()


if __name__ == "__main__":
    main()
