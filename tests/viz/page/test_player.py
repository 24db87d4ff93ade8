"""The report page in browsers: it plays from disk alone, whatever the camera names."""

import contextlib
import dataclasses
import shutil
import socket

import cv2
import numpy as np
import pytest

from catfree._run._result_folder import write_results
from catfree._run._run import RunOutcome
from catfree.adapters import SynchronizedVideos
from catfree.viz import write_overlay_video

pytestmark = pytest.mark.slow

NAMES = ("<script>document.title='broken'</script>", "</script>&amp;", "a'b\"c", "plain")
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
FIREFOX = ("firefox-esr", "firefox")
FLAGS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)


def installed(browsers):
    """Return the first installed browser, or skip with a reason."""
    found = next(filter(None, map(shutil.which, browsers)), None)
    if found is None:
        pytest.skip(f"none of {', '.join(browsers)} is installed: there is nothing to open pages")
    return found


@pytest.fixture(scope="module")
def browser():
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = installed(CHROMIUM)
    with driver.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=found, args=FLAGS.split())
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def report(world, localization, tmp_path_factory):
    """Write a report with pictures; picture t of camera c has green 20 (t + 1) and red 50 c."""
    root = tmp_path_factory.mktemp("report")
    width, height = (int(side) for side in world.scene.rig.image_size[0])
    folders = []
    for camera in range(4):
        folders.append(root / f"camera{camera}")
        folders[-1].mkdir()
        for frame in range(12):
            picture = np.full((height, width, 3), (0, 20 * (frame + 1), 50 * camera), np.uint8)
            cv2.imwrite(str(folders[-1] / f"{frame:02d}.jpg"), picture)
    found = dataclasses.replace(localization, warnings=("<b>Mind</b> the gap.",))
    videos = SynchronizedVideos(folders, frame_rate=5)
    boxes = dataclasses.replace(world.detections, clock=videos.clock)
    outcome = RunOutcome(found, boxes, world.scene, None, NAMES, np.arange(12), videos)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("catfree._run._result_folder.draw_pictures", lambda *_, **__: [])  # slow
        write_results(root / "out", outcome, videos=videos, pictures=True, overlay=True)
    write_overlay_video(root / "out" / "overlay.webm", videos, boxes, found, world.scene, width=640)
    return root / "out" / "report.html"


@pytest.fixture
def page(browser, report):
    """Open the report; console output and requests outside the folder fail the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    tab, wrong = context.new_page(), []
    tab.on("console", lambda message: wrong.append(message.text))
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("requestfailed", lambda request: wrong.append(request.url))
    folder = report.parent.as_uri()
    tab.on("request", lambda r: None if r.url.startswith(folder) else wrong.append(r.url))
    tab.goto(report.as_uri())
    tab.wait_for_timeout(300)
    yield tab
    context.close()
    assert wrong == []


def instant(page):
    return int(page.input_value("#instant"))


def pixel(page, canvas, x, y):
    """Return red, green and blue on the screen at fractions of a canvas' width and height."""
    box = page.locator(canvas).bounding_box()
    clip = {"x": box["x"] + x * box["width"], "y": box["y"] + y * box["height"]}
    shot = page.screenshot(clip={**clip, "width": 1, "height": 1})
    return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[0, 0, ::-1].tolist()


def test_it_plays_pauses_and_steps(page):
    assert instant(page) == 0
    page.keyboard.press(" ")
    page.wait_for_function("Number(document.getElementById('instant').value) >= 2", timeout=5000)
    assert page.inner_text("#play") == "Pause"
    page.keyboard.press(" ")
    assert page.inner_text("#play") == "Play"
    stopped = instant(page)
    page.wait_for_timeout(500)
    assert instant(page) == stopped
    for key, step in (("ArrowLeft", -1), ("ArrowRight", 1), ("Shift+ArrowLeft", -10)):
        before = instant(page)
        page.keyboard.press(key)
        assert instant(page) == max(before + step, 0)
    page.click("#play")
    page.wait_for_function("document.getElementById('play').textContent === 'Play'", timeout=9000)
    assert instant(page) == 11  # it stops at the end, and begins again from there
    page.click("#play")
    page.wait_for_function("Number(document.getElementById('instant').value) < 5", timeout=5000)


def test_the_slider_moves_plan_and_pictures_together(page):
    page.uncheck("#show-boxes")
    plan = page.locator("#plan").screenshot()
    for frame in (7, 3):
        page.locator("#instant").fill(str(frame))
        assert f"frame {frame} · {frame / 5:.2f} s" in page.inner_text("#readout")
        page.wait_for_timeout(300)
        page.keyboard.press("4")  # the last camera alone
        red, green, blue = pixel(page, "#views", 0.5, 0.5)
        assert abs(red - 150) < 12
        assert abs(green - 20 * (frame + 1)) < 12
        assert blue < 12
        page.keyboard.press("0")
    assert page.locator("#plan").screenshot() != plan


def test_a_click_enlarges_a_camera_and_another_shows_all(page):
    page.uncheck("#show-boxes")
    whole = page.locator("#views").screenshot()
    page.locator("#views").click(position={"x": 150, "y": 90})
    assert page.locator("#views").screenshot() != whole
    assert pixel(page, "#views", 0.5, 0.5)[0] < 12  # the first camera
    page.locator("#views").click()
    page.mouse.move(5, 5)
    assert page.locator("#views").screenshot() == whole


def test_the_overlay_video_plays(page):
    assert page.evaluate("document.querySelector('video').play().then(() => 'plays')") == "plays"
    page.wait_for_function("document.querySelector('video').currentTime > 0.5", timeout=9000)
    video = "(({ error, videoWidth }) => [error, videoWidth])(document.querySelector('video'))"
    assert page.evaluate(video) == [None, 640]


def test_layers_can_be_hidden(page):
    for layer, canvas in (
        ("boxes", "#views"),
        ("ellipses", "#plan"),
        ("trails", "#plan"),
        ("coverage", "#plan"),
    ):
        page.locator("#instant").fill("8")
        shown = page.locator(canvas).screenshot()
        page.uncheck(f"#show-{layer}")
        assert page.locator(canvas).screenshot() != shown


def test_text_is_escaped(page, report):
    assert page.title() == "catfree report"
    text = page.inner_text("body")
    assert NAMES[0] in text
    assert NAMES[1] in text
    assert "<b>Mind</b> the gap." in text
    assert page.locator("script").count() == 2
    assert page.locator("b").count() == 0
    names = page.evaluate(
        "JSON.parse(document.getElementById('player-data').textContent).cameras.map(c => c.name)"
    )
    assert names == list(NAMES)


def test_warnings_player_and_checks_come_first_and_settings_are_folded(page):
    tops = [
        page.locator(name).bounding_box()["y"]
        for name in (".notice", ".player", "text=Acceptance", "text=Footage")
    ]
    assert tops == sorted(tops)
    assert page.locator("#play").bounding_box()["y"] < 720  # without scrolling
    assert not page.locator("text=rays.sigma_theta").is_visible()
    page.click("summary")
    assert page.locator("text=rays.sigma_theta").is_visible()


def test_light_and_dark_follow_the_reader(page):
    for scheme, bright in (("light", True), ("dark", False), ("light", True)):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(100)
        for canvas in ("#plan", "#views"):
            assert (min(pixel(page, canvas, 0.998, 0.02)) > 200) is bright
        color = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (color == "rgb(255, 255, 255)") is bright


def test_every_control_is_reached_by_the_keyboard(page):
    reached = set()
    for _ in range(24):  # the controls of the video among them
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id || document.activeElement.tagName"))
    wanted = {"play", "instant", "speed", "SUMMARY"}
    assert wanted | {f"show-{n}" for n in ("ellipses", "trails", "boxes", "coverage")} <= reached


def test_missing_pictures_are_told(browser, report, tmp_path):
    """The page alone, copied elsewhere, still plays the map and the boxes."""
    copied = shutil.copy(report, tmp_path / "report.html")
    with contextlib.closing(browser.new_page()) as tab:
        errors = []
        tab.on("pageerror", lambda error: errors.append(error))
        tab.goto((tmp_path / "report.html").as_uri())
        tab.keyboard.press("ArrowRight")
        tab.keyboard.press(" ")
        tab.wait_for_function("Number(document.getElementById('instant').value) >= 3", timeout=5000)
        assert errors == []
        assert copied.is_file()


@pytest.fixture
def firefox(report, tmp_path):
    """Open the report in Firefox; page errors and requests elsewhere fail the test."""
    driver = pytest.importorskip(
        "marionette_driver.marionette", reason="marionette_driver is not installed"
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    client = driver.Marionette(
        bin=installed(FIREFOX), headless=True, port=port, workspace=str(tmp_path),
        gecko_log=str(tmp_path / "firefox.log"),
    )  # fmt: skip
    try:
        client.start_session()
        client.timeout.script = client.timeout.implicit = 10
        client.navigate(report.as_uri())
        yield client
        folder = report.parent.as_uri()
        fetched = client.execute_script(
            "return performance.getEntriesByType('resource').map(entry => entry.name)"
        )
        assert [url for url in fetched if not url.startswith(folder)] == []
        with client.using_context(client.CONTEXT_CHROME):
            said = client.execute_script(
                "return Services.console.getMessageArray().map(entry => entry.message)",
                sandbox=None,
            )
        assert [line for line in said if folder in line] == []
    finally:
        client.cleanup()


# The driver leaves a socket to the garbage collector while Firefox does not answer.
leaves_sockets_open = pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)


def eventually(firefox, condition):
    """Return whether an expression becomes true within some seconds."""
    return firefox.execute_async_script(
        f"""
        const done = arguments[0], until = Date.now() + 9000;
        const look = () => {condition} || Date.now() > until
          ? done(Boolean({condition})) : setTimeout(look, 20);
        look();
        """
    )


@leaves_sockets_open
def test_firefox_plays_the_page(firefox):
    def value():
        return int(firefox.execute_script("return document.getElementById('instant').value"))

    body = firefox.find_element("tag name", "body")
    assert value() == 0
    body.send_keys(" ")
    assert eventually(firefox, "Number(document.getElementById('instant').value) >= 2")
    body.send_keys(" ")
    stopped = value()
    body.send_keys("\ue014")  # the right arrow
    assert value() == min(stopped + 1, 11)
    assert f"frame {value()} " in firefox.find_element("id", "readout").text
    text = firefox.find_element("tag name", "body").text
    assert all(name in text for name in NAMES[:2])


@leaves_sockets_open
def test_firefox_plays_the_overlay_video(firefox):
    firefox.execute_script("document.querySelector('video').muted = true")
    assert firefox.execute_async_script(
        "document.querySelector('video').play().then(() => arguments[0]('plays'), arguments[0])"
    ) == "plays"  # fmt: skip
    assert eventually(firefox, "document.querySelector('video').currentTime > 0.5")
    video = "(({ error, videoWidth }) => [error, videoWidth])(document.querySelector('video'))"
    assert firefox.execute_script(f"return {video}") == [None, 640]
