"""The timeline of a camera path: keys that are dragged and moved by the keyboard, and the preview beside them."""

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from test_page_paths import choose, times  # noqa: E402


@pytest.fixture
def turn(scene):
    """A whole turn: eight keys in 6 s."""
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".mark")) == 8, "eight marks")
    scene.driver.execute_script("document.querySelector('.lane').scrollIntoView({block: 'center'})")
    return scene


def drag(page, mark, *steps):
    """So many pixels to the right, in turn, with one press."""
    chain = ActionChains(page.driver).click_and_hold(mark)
    for pixels in steps:
        chain = chain.move_by_offset(pixels, 0)
    chain.release().perform()


def clock_of_the_scrubber(page):
    return page.run("return `${Number(document.querySelector('.scrub').value).toFixed(2)} s`;")


def test_a_key_is_dragged_along_the_timeline_and_stops_at_its_neighbours(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".mark")) == 8, "eight marks")
    before = [key["time"] for key in scene.path()["keys"]]
    mark = scene.all(".mark")[1]
    scene.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", mark)
    ActionChains(scene.driver).click_and_hold(mark).move_by_offset(20, 0).move_by_offset(
        12, 0).release().perform()
    after = scene.until(
        lambda: (t := [key["time"] for key in scene.path()["keys"]]) != before and t, "a change")
    assert before[1] < after[1] < before[2] and after[2:] == before[2:]
    ActionChains(scene.driver).click_and_hold(mark).move_by_offset(900, 0).release().perform()
    far = [key["time"] for key in scene.path()["keys"]]
    assert far == sorted(far) and far[1] < far[2]
    mark.send_keys(Keys.ARROW_LEFT)
    assert scene.path()["keys"][1]["time"] < far[1]


def test_the_last_key_is_dragged_by_as_much_as_the_pointer_goes(scene):
    """It is the end of the scale, which moved under the pointer: a path fell to nothing, and grew no more."""
    choose(scene, "arc")
    scene.until(lambda: len(scene.all(".mark")) == 5, "five marks")
    mark = scene.all(".mark")[4]
    scene.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", mark)
    width = scene.run("return document.querySelector('.track').clientWidth;")
    for pixels in (-20, 30):
        before = times(scene)[4]
        chain = ActionChains(scene.driver).click_and_hold(mark)
        for _ in range(5):
            chain = chain.move_by_offset(pixels // 5, 0)
        chain.perform()
        assert times(scene)[4] - before == pytest.approx(pixels * before / width, abs=0.02)
        scene.says(f"{times(scene)[4]:.2f} s", ".clock")
        ActionChains(scene.driver).release().perform()
        scene.says(clock_of_the_scrubber(scene), ".clock")
    assert times(scene)[:4] == [0, 1, 2, 3]


def test_of_keys_on_a_heap_the_one_is_dragged_that_can_go_there(turn):
    """The second, dragged as far as it goes, lies under the third, and was never had back."""
    drag(turn, turn.all(".mark")[1], 200)
    heap = times(turn)
    assert heap[2] - heap[1] == pytest.approx(0.02)
    drag(turn, turn.all(".mark")[2], 30)
    right = times(turn)
    assert right[2] > heap[2] + 0.1 and right[:2] == heap[:2] and right[3:] == heap[3:]
    turn.press("Undo")
    drag(turn, turn.all(".mark")[2], -30)
    left = times(turn)
    assert left[1] < heap[1] - 0.1 and left[2:] == heap[2:]
    turn.press("Undo")
    turn.all(".mark")[1].send_keys(Keys.ENTER)
    assert turn.run("""
const mark = document.querySelector('.mark[data-selected=true]');
const {left, top} = mark.getBoundingClientRect();
return document.elementFromPoint(left + 12, top + 12).closest('.mark') === mark;"""), "the chosen one lies over it"


def test_of_marks_that_overlap_the_nearest_is_dragged(turn):
    """What covers half of another is not taken for it where that is seen."""
    close = times(turn)[2] - 6 * 6 / turn.run("return document.querySelector('.track').clientWidth;")
    turn.type(turn.all(".key")[1].find_element("css selector", "[aria-label='Time, seconds']"), close)
    turn.all(".key")[1].find_element("css selector", "[aria-label='Time, seconds']").send_keys(Keys.TAB)
    turn.driver.execute_script("document.querySelector('.lane').scrollIntoView({block: 'center'})")
    before = times(turn)
    assert before[1] == pytest.approx(close, abs=0.01)
    mark = turn.all(".mark")[1]
    ActionChains(turn.driver).move_to_element_with_offset(mark, -3, 0).click_and_hold().move_by_offset(
        -40, 0).release().perform()
    assert times(turn)[1] < before[1] - 0.1 and times(turn)[2:] == before[2:]


def test_a_drag_that_moves_nothing_is_no_step(turn):
    before = times(turn)
    drag(turn, turn.all(".mark")[0], -40)  # the first is at 0
    assert times(turn) == before
    drag(turn, turn.all(".mark")[3], 20, 5)
    assert times(turn) != before
    drag(turn, turn.all(".mark")[0], -40)
    turn.press("Undo")
    assert times(turn) == before
    turn.press("Undo")
    turn.says("No keys yet")


def test_a_drag_is_one_step_however_long_it_takes(page, fake):
    page.open(fake("empty").url)
    assert page.run("""
const {createHistory} = await load('path.js');
const history = createHistory();
const drags = [{}, {}];
history.note('a', drags[0], 0);
history.note('b', drags[0], 5000);
history.note('c', drags[1], 5001);
history.note('d', 'word', 6000);
history.note('e', 'word', 8000);
return ['f', 'e', 'd', 'c', 'a'].map((now) => history.undo(now));""") == ["e", "d", "c", "a", None]


def test_a_key_that_was_dragged_is_gone_to_by_the_keyboard(turn):
    drag(turn, turn.all(".mark")[2], 15)
    turn.all(".mark")[2].send_keys(Keys.ENTER)
    turn.find(".mark[data-selected=true]")
    turn.says("Key 3", ".key-numbers")


def test_keys_are_moved_and_removed_by_the_keyboard(turn):
    turn.all(".mark")[2].send_keys(Keys.ARROW_RIGHT)
    assert times(turn)[2] == pytest.approx(1.6)
    turn.says("Key 3 at 1.60 s", "#announcer")
    turn.all(".mark")[7].send_keys(Keys.SHIFT + Keys.ARROW_RIGHT)
    assert times(turn)[7] == pytest.approx(6.25)
    turn.all(".mark")[2].send_keys(Keys.DELETE)
    turn.until(lambda: len(turn.all(".mark")) == 7, "seven marks")
    assert 1.6 not in [round(time, 3) for time in times(turn)]
    assert "Key 3 at 2.25 s" in turn.run("return document.activeElement.getAttribute('aria-label');")


@pytest.mark.parametrize("what", ["a key", "the scrubber", "the picture"])
def test_a_preview_gives_way_to_the_reader(turn, what):
    """Its next frame took back what was chosen while it ran."""
    turn.press("Preview")
    turn.button("Stop")
    if what == "a key":
        turn.all(".mark")[3].click()
    elif what == "the scrubber":
        turn.driver.execute_script(
            "const s = document.querySelector('.scrub'); s.value = 4; s.dispatchEvent(new Event('input'));")
    else:
        drag(turn, turn.find(".stage"), 40)
    turn.button("Preview")
    if what != "the picture":
        turn.says("2.25 s" if what == "a key" else "4.00 s", ".clock")
        turn.says(clock_of_the_scrubber(turn), ".clock")
    here = next(button for button in turn.all(".reel button") if button.text == "Key here")
    assert here.is_enabled() == (what != "a key")


def test_a_preview_draws_what_lies_over_its_picture_once_a_frame(turn):
    turn.press("Preview")
    most = turn.driver.execute_async_script("""
const done = arguments[0];
const clear = CanvasRenderingContext2D.prototype.clearRect;
let [draws, most, frames] = [0, 0, 0];
CanvasRenderingContext2D.prototype.clearRect = function (...box) {
  draws += this.canvas.matches('.overlay');
  clear.apply(this, box);
};
const frame = () => {
  if (frames++) most = Math.max(most, draws);
  draws = 0;
  if (frames < 12) return requestAnimationFrame(frame);
  CanvasRenderingContext2D.prototype.clearRect = clear;
  done(most);
};
requestAnimationFrame(frame);""")
    assert most == 1
    turn.press("Stop")


def test_at_constant_speed_keys_lie_where_they_are_passed(page, fake):
    """The way says when; a key that was put there then went to where the keys' clock said so, out of the order."""
    page.open(fake("empty").url)
    eye, moments, back, order = page.run("""
const p = await load('path.js');
const key = (id, time, x) => ({id, time, fovDeg: 40, pose: [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0]]});
const path = {...p.emptyPath(64, 48), interpolation: 'linear', constantSpeed: true,
              keys: [key('a', 2, 0), key('b', 3, 5), key('c', 12, 6)]};
const moments = path.keys.map((_, i) => p.momentOf(path, i));
const {pose, fovDeg} = p.cameraAt(path, 5);
const more = p.insertKey(path, 2 + p.timeOfWay(path, 5), pose, fovDeg);
return [pose[0][3], moments, moments.map((moment) => p.timeOfWay(path, moment)), more.keys.map((one) => one.pose[0][3])];""")
    assert eye == pytest.approx(3) and order == sorted(order)
    assert moments == pytest.approx([0, 10 * 5 / 6, 10])
    assert back == pytest.approx([0, 1, 10])


def test_at_constant_speed_a_key_between_the_ends_stays_where_the_way_has_it(scene):
    choose(scene, "arc")
    scene.until(lambda: len(scene.all(".mark")) == 5, "five marks")
    scene.all(".mark")[1].send_keys(Keys.SHIFT + Keys.ARROW_LEFT)
    left = "return [...document.querySelectorAll('.mark')].map((mark) => parseFloat(mark.style.left));"
    assert scene.run(left)[1] == pytest.approx(0.5, abs=0.1)  # 0.02 s of 4 s
    scene.driver.find_element("id", "path-steady").click()
    assert scene.run(left) == pytest.approx([0, 25, 50, 75, 100], abs=0.1)
    scene.driver.execute_script("document.querySelector('.lane').scrollIntoView({block: 'center'})")
    before = times(scene)
    drag(scene, scene.all(".mark")[2], 30)
    assert times(scene) == before
    drag(scene, scene.all(".mark")[4], -30)
    assert times(scene)[4] < 4 and times(scene)[:4] == before[:4]
    scene.all(".mark")[1].click()
    scene.says(clock_of_the_scrubber(scene), ".clock")
