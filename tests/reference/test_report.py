"""The report page, driven by hand and by keyboard in a headless browser where one is installed."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from raytrace2.reference.comparison import Comparison, compare_batches
from raytrace2.reference.report import write_report

TITLE = "a </script><script>alert(1)</script> & room"


def _comparison() -> Comparison:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:48, 0:64]
    scene = np.stack([x / 64, y / 48, 0.3 + 0.2 * ((x // 8 + y // 8) % 2)], axis=2)
    ours, reference = (scene + 0.05 * rng.normal(size=(8, *scene.shape)) for _ in range(2))
    ours[:, 20:34, 30:46] *= 0.5
    return compare_batches(
        ours, reference, title=TITLE, seconds=1.5, reference_seconds=2.5, settings={"Samples per pixel": "64"}
    )


def test_the_page_needs_nothing_but_itself(tmp_path: Path) -> None:
    page = _comparison().report(tmp_path / "new" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)\s*=\s*["']|url\(|@import|https?://""", page)
    assert "default-src 'none'" in page and "alert(1)</script>" not in page
    assert [f.name for f in (tmp_path / "new").iterdir()] == ["report.html"]


def test_a_failed_report_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    with pytest.raises(ValueError):
        black = np.zeros((4, 4, 3))
        write_report(path, ours=black, reference=black, title="t", figures={}, worst_tile=(0, 0, 9, 9))
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_images_that_are_not_finite_can_be_reported(tmp_path: Path) -> None:
    image = np.full((4, 4, 3), 1e9)
    image[1, 1], image[2, 2] = math.nan, math.inf
    write_report(tmp_path / "r.html", ours=image, reference=np.zeros((4, 4, 3)), title="t", figures={})
    write_report(tmp_path / "r.html", ours=image[:1, :1], reference=image[:1, :1], title="t", figures={})


def test_comparison_in_a_notebook_and_without_batches() -> None:
    comparison = _comparison()
    shown = comparison._repr_html_()
    assert comparison.consistent is False and "differ by more than noise" in shown and "<script>" not in shown
    one = compare_batches(np.ones((1, 4, 4, 3)), np.ones((1, 4, 4, 3)), title="t", seconds=1.0, reference_seconds=1.0)
    assert one.noise is None and one.consistent is None and one.rmse == 0.0 and one.psnr == math.inf


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver")
    from selenium.webdriver.chrome.service import Service

    binary, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip("no chromium and chromedriver are installed: the report page was not driven")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in (
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--window-size=1200,1400",
        f"--user-data-dir={tmp_path_factory.mktemp('profile')}",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    page = webdriver.Chrome(options=options, service=Service(driver))
    try:
        yield page
    finally:
        page.quit()


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Any:
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get(_comparison().report(tmp_path / "report.html").as_uri())
    WebDriverWait(browser, 20).until(lambda b: b.execute_script("return document.documentElement.dataset.ready"))
    return browser


def _state(page: Any) -> tuple[int, float, float]:
    """Value told to screen readers, share of our image that is shown, and the handle's place, the latter two in
    percent."""
    value, clip, left = page.execute_script(
        "const h = document.getElementById('handle');"
        "return [h.getAttribute('aria-valuenow'), document.getElementById('left').style.clipPath, h.style.left]"
    )
    hidden = re.fullmatch(r"inset\((?:0px|0) ([\d.]+)%(?: (?:0px|0)){0,2}\)", clip)
    assert hidden, clip
    return int(value), 100.0 - float(hidden[1]), float(left.rstrip("%"))


def test_a_hand_drags_the_slider(page: Any) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    stage = page.find_element("id", "stage")
    assert _state(page)[0] == 50
    width = stage.size["width"]
    ActionChains(page).move_to_element(stage).click_and_hold().move_by_offset(-round(width / 4), 30).perform()
    value, shown, place = _state(page)
    assert value == pytest.approx(25, abs=1) and shown == pytest.approx(place) == pytest.approx(25, abs=1)
    ActionChains(page).move_by_offset(round(0.76 * width), 0).release().perform()
    assert _state(page)[0] == 100
    ActionChains(page).move_by_offset(-round(width / 2), 0).perform()
    assert _state(page)[0] == 100, "the slider follows a hand that has let go"


def test_a_finger_drags_the_slider(page: Any) -> None:
    box = page.execute_script(
        "const r = document.getElementById('stage').getBoundingClientRect(); return [r.x, r.y, r.width, r.height]"
    )
    x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
    page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for i in range(1, 6):
        point = {"x": x + i * box[2] / 20, "y": y}
        page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [point]})
    page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    value, shown, _ = _state(page)
    assert value == pytest.approx(75, abs=2) and shown == pytest.approx(75, abs=2)


def test_keys_drive_the_slider(page: Any) -> None:
    from selenium.webdriver.common.keys import Keys

    handle = page.find_element("id", "handle")
    assert handle.get_attribute("role") == "slider" and handle.get_attribute("aria-label")
    steps = [
        (Keys.ARROW_RIGHT, 51),
        (Keys.ARROW_LEFT, 50),
        (Keys.PAGE_UP, 60),
        (Keys.ARROW_UP, 61),
        (Keys.ARROW_DOWN, 60),
        (Keys.PAGE_DOWN, 50),
        (Keys.SHIFT + Keys.ARROW_LEFT, 40),
        (Keys.HOME, 0),
        (Keys.ARROW_LEFT, 0),
        (Keys.END, 100),
    ]
    for key, expected in steps:
        handle.send_keys(key)
        value, shown, place = _state(page)
        assert value == expected and shown == pytest.approx(expected) and place == pytest.approx(expected)
    assert "100 % raytrace2" in handle.get_attribute("aria-valuetext")
    assert page.execute_script("return getComputedStyle(document.activeElement, '::after').boxShadow") != "none"


def test_exposure_and_gain_and_kind_redraw(page: Any) -> None:
    def pixel(canvas: str, y: int = 25, x: int = 35) -> list[int]:
        return list(
            page.execute_script(
                "const [id, x, y] = arguments, context = document.getElementById(id).getContext('2d');"
                "return [...context.getImageData(x, y, 1, 1).data]",
                canvas,
                x,
                y,
            )
        )

    def put(control: str, value: float) -> None:
        page.execute_script(
            "const [id, value] = arguments, e = document.getElementById(id);"
            "e.value = value; e.dispatchEvent(new Event('input'))",
            control,
            value,
        )

    comparison = _comparison()
    linear = comparison.reference[25, 35].astype(float)
    for stops in (0, 1, -2):
        put("exposure", stops)
        v = np.clip(linear * 2.0**stops, 0, 1)
        expected = 255 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
        np.testing.assert_allclose(pixel("right")[:3], expected, atol=1.5)
    put("gain", 1)
    signed = 255 * np.clip(0.5 + (comparison.ours - comparison.reference)[25, 35], 0, 1)
    np.testing.assert_allclose(pixel("difference")[:3], signed, atol=1.5)
    page.execute_script("document.querySelector('input[value=absolute]').click()")
    assert max(abs(a - b) for a, b in zip(pixel("difference")[:3], signed, strict=True)) > 3


def test_the_worst_tile_is_shown_and_nothing_complains(page: Any) -> None:
    assert page.find_element("id", "title").text == TITLE
    assert "differ by more than noise" in page.find_element("id", "verdict").text
    assert page.find_elements("css selector", "#reasons li")
    for canvas in ("tile-ours", "tile-reference", "tile-difference"):
        element = page.find_element("id", canvas)
        assert element.is_displayed() and element.value_of_css_property("image-rendering") == "pixelated"
        assert int(element.get_attribute("width")) <= 32 < element.size["width"]
    tile = page.execute_script("return JSON.parse(document.getElementById('data').textContent).tile")
    assert tile[0] < 34 and tile[2] > 20 and tile[1] < 46 and tile[3] > 30
    for image in ("flip", "z"):
        assert page.execute_script("return document.getElementById(arguments[0]).naturalWidth", image) == 64
    rows = page.find_element("id", "figures").text
    assert all(name in rows for name in ("RMSE", "relMSE", "PSNR", "FLIP", "Time, raytrace2", "Time, Mitsuba"))
    # Reading pixels back, as the tests above do, draws advice from Chromium itself.
    assert [entry for entry in page.get_log("browser") if entry["source"] != "rendering"] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_fits_a_phone(page: Any, scheme: str) -> None:
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True}
    )
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    try:
        assert page.execute_script("return document.documentElement.scrollWidth") == 360
        red = page.execute_script("return getComputedStyle(document.body).backgroundColor.match(/\\d+/)[0]")
        assert (int(red) > 128) == (scheme == "light")
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
