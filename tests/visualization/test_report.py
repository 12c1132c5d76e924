"""The report: one page that needs nothing else, and says what the files of the run say."""

import base64
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.errors import RunError
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks
from docdepth.pipeline.render import report
from docdepth.visualization import report_images
from docdepth.visualization.drive_map import DriveMap, drive_map, heights_above_ground, map_section
from docdepth.visualization.page import embedded
from docdepth.visualization.pictures import colorize
from docdepth.visualization.report import HELD_OUT
from docdepth.visualization.report_images import IMAGES, budget
from small_drive import write_small_drive


class Page(HTMLParser):
    """Links, pictures and texts of a page; every element that must be closed is closed."""

    _ALONE = frozenset({"meta", "img", "input", "image", "polyline", "polygon", "line"})
    _CLOSE_THEMSELVES = frozenset({"html", "tr", "td", "th", "li", "p"})

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text = path.read_text(encoding="utf-8")
        self.links: list[str] = []
        self.images: dict[tuple[str, str], str] = {}
        self.open: list[str] = []
        self.feed(self.text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.links += [known[name] for name in ("src", "href") if name in known]
        if "data-view" in known:
            self.images[known["data-image"], known["data-view"]] = known["src"]
        if tag not in self._ALONE | self._CLOSE_THEMSELVES:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self._ALONE | self._CLOSE_THEMSELVES:
            assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        if tag not in self._ALONE:
            raise AssertionError(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def drive(self) -> dict:
        return json.loads(re.search(r"id=drive>(.*?)</script>", self.text, re.S)[1])


def decoded(link: str) -> np.ndarray:
    content = base64.b64decode(link.removeprefix("data:image/jpeg;base64,"))
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture(scope="module")
def page(finished) -> Page:
    return Page(finished[0] / "report" / "index.html")


def test_the_page_needs_no_other_file(page):
    assert page.links
    assert all(re.match(r"data:image/(jpe|pn)g;base64,", link) for link in page.links)
    assert not re.search(r"https?://(?!www.w3.org/2000/svg)|@import|url\(", page.text)


def test_pictures_show_the_image_and_its_depth(drive, finished, page):
    names = re.findall(r"<span class=name[^>]*>image (\w+) at", page.text)
    assert names == sorted(path.stem for path in (finished[0] / "depth").glob("*.png"))
    stream = open_dataset(drive).cameras["image_2"]
    for k, name in enumerate(names):
        depth = colorize(read_depth(finished[0] / "depth" / f"{name}.png"), bar=False)
        image = stream.rectified_image(stream.names.index(name))
        for view, whole in (("depth", depth), ("image", image)):
            assert np.abs(decoded(page.images[str(k), view]).astype(int) - whole).mean() < 5
        assert (str(k), "class") in page.images
        assert (str(k), "confidence") not in page.images
    assert "No photos" not in page.text


def test_layers_of_the_run_are_shown_and_parameters_that_differ(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    layers = ("class", "confidence", "seen", "instance")
    assert (
        cli("render", run, "--layers", ",".join(layers), "--set", "render.ahead=40").exit_code == 0
    )
    page = Page(run / "report" / "index.html")
    assert {view for _, view in page.images} == {"image", "depth", *layers}
    assert re.search(r"<td>render.ahead</td><td>40.0 m</td><td>80.0 m</td>", page.text)
    assert "render.behind" not in page.text
    shown = decoded(page.images["0", "seen"])
    with np.load(sorted((run / "layers").glob("*.npz"))[0]) as kept:
        agree = kept["seen"] == 1
    blue, _, red = shown[agree].mean(axis=0)
    assert blue > red + 40


def test_tracks_and_path_are_where_the_run_says(finished, page):
    run = RunFolder.open(finished[0])
    poses, found = run.trajectory().poses, page.drive()
    drawn = drive_map(run)
    cos, sin = np.cos(drawn.heading), np.sin(drawn.heading)

    def pixel(x, y):  # turned, then counted from the upper left corner
        right, up = cos * x + sin * y, cos * y - sin * x
        return (right - drawn.corner[0]) / drawn.cell, (drawn.corner[1] - up) / drawn.cell

    assert len(found["path"]) == len(poses)
    for place, pose in zip(found["path"], poses, strict=True):
        np.testing.assert_allclose(place[:2], pixel(*pose[:2, 3]), atol=0.06)
    assert found["path"][-1][0] > found["path"][0][0]
    tracks = {track.id: track for track in read_tracks(finished[0] / "tracks.csv")}
    assert {track["id"] for track in found["tracks"]} == set(tracks)
    for shown in found["tracks"]:
        track = tracks[shown["id"]]
        np.testing.assert_allclose(shown["places"][0][:2], pixel(*track.poses[0, :2, 3]), atol=0.06)
        np.testing.assert_allclose(np.multiply(shown["size"], drawn.cell), track.size[:2], atol=0.1)
        ahead = np.add(track.poses[0, :2, 3], track.poses[0, :2, 0])
        step = np.subtract(pixel(*ahead), pixel(*track.poses[0, :2, 3])) * drawn.cell
        angle = shown["places"][0][2]
        np.testing.assert_allclose((np.cos(angle), np.sin(angle)), step, atol=0.02)


def test_the_map_is_dark_where_something_stands_and_nowhere_else(finished):
    run = RunFolder.open(finished[0])
    drawn = drive_map(run)
    record, classid = run.classified_frame(2)
    pose = run.trajectory().poses[2]
    world = record.points @ pose[:3, :3].T + pose[:3, 3]
    column, row = np.floor(drawn.pixels(world)).astype(int).T
    height, width = drawn.picture.shape[:2]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    tones = np.full(len(world), -1)
    tones[inside] = drawn.picture[row[inside], column[inside], 0]
    above = heights_above_ground(record.points, classid < STATIC)
    low = inside & (classid < DYNAMIC) & (above > 1) & (above < 3)
    assert low.sum() > 100
    assert (tones[low] < 165).all()
    assert (tones[inside & (classid < STATIC)] <= 228).all()
    assert (drawn.picture == 255).mean() > 0.3


def test_heights_are_those_above_a_hill():
    rng = np.random.default_rng(3)
    points = rng.uniform((-40, -40, 0), (40, 40, 0), (20_000, 3)).astype(np.float32)
    above = rng.uniform(0, 5, len(points)) * (rng.random(len(points)) < 0.3)
    points[:, 2] = 0.1 * points[:, 0] + above - 1.7
    found = heights_above_ground(points, above == 0)
    assert np.abs(found - above).max() < 0.25
    assert (found[above == 0] == 0).all()
    assert (heights_above_ground(points, np.zeros(len(points), bool)) == 0).all()


def test_the_page_stays_small_whatever_is_on_the_images():
    noise = np.random.default_rng(0).integers(0, 255, (375, 1242, 3), np.uint8)
    assert len(embedded(noise)) > 500_000
    assert len(embedded(noise, 90_000)) < 90_000 * 4 / 3 + 100
    assert len(embedded(noise, 2_000)) < 2_000 * 4 / 3 + 100
    for cameras in range(1, 60):
        count, most = budget(cameras)
        assert 1 <= count <= IMAGES
        assert cameras * count * 6 * most * 4 / 3 < 12_000_000
    assert budget(1)[0] == IMAGES


def test_the_map_of_a_long_drive_stays_small():
    sweeps = 40_000
    poses = np.repeat(np.eye(4)[None], sweeps, axis=0)
    poses[:, 0, 3] = np.arange(sweeps)
    times = np.arange(sweeps) * 100_000_000
    tracks = [
        Track(
            k + 1, "vehicle", times[k * 4 : k * 4 + 60 + k % 2], poses[k * 4 : k * 4 + 60 + k % 2],
            np.ones((60 + k % 2, 3)), np.ones(3), np.ones(60 + k % 2, int), np.ones(60 + k % 2),
            np.ones(60 + k % 2),
        )
        for k in range(9000)
    ]  # fmt: skip
    drawn = DriveMap(np.zeros((50, 1400, 3), np.uint8), 0.0, np.array((0.0, 25.0)), 30.0)
    section = map_section(drawn, Trajectory(times, poses), tracks)
    assert len(section) < 2_500_000
    assert "the 3000 of 9000 that were seen longest" in section
    assert section.count("<title>") == 3000
    first, *_, last = re.search(r'class=path [^>]*points="([^"]*)"', section)[1].split()
    assert (first, last) == ("0.0,0.8", "1333.3,0.8")
    found = json.loads(re.search(r"id=drive>(.*?)</script>", section, re.S)[1])
    assert sum(len(track["places"]) for track in found["tracks"]) <= 20_000


def test_held_out_errors_are_shown_until_the_depth_changes(tmp_path):
    drive, run = write_small_drive(tmp_path / "drive"), tmp_path / "run"
    assert cli("run", drive, "-o", run).exit_code == 0
    page = run / "report" / "index.html"
    assert "not measured yet" in page.read_text()
    printed = cli("evaluate", "held-out", run, "--every", "2").output
    number = re.search(r"^all +(\S+)", printed, re.M)[1]
    assert f"<td>all</td><td>{number}</td>" in page.read_text()
    assert report(RunFolder.open(run)) == page
    assert f"<td>all</td><td>{number}</td>" in page.read_text()
    assert cli("render", run, "--set", "render.ahead=7").exit_code == 0
    assert "not measured yet" in page.read_text()
    assert not (run / "report" / HELD_OUT).exists()


def test_a_report_without_the_recording_has_no_images(tmp_path):
    drive, run = write_small_drive(tmp_path / "drive"), tmp_path / "run"
    assert cli("run", drive, "-o", run).exit_code == 0
    shutil.move(drive, tmp_path / "elsewhere")
    report(RunFolder.open(run))
    page = Page(run / "report" / "index.html")
    assert {view for _, view in page.images} == {"depth", "class"}
    assert "No photos" in page.text
    (run / "frames" / "frame_000001.ply").unlink()
    with pytest.raises(RunError, match="frame_000001"):
        report(RunFolder.open(run))


_USED = """<script>addEventListener("load", () => {
const frame = document.querySelector(".views"), wiper = document.querySelector(".wipe");
const box = frame.getBoundingClientRect(), told = frame.querySelector("output"), found = [];
for (let row = 0; row < HEIGHT; ++row) for (let column = 0; column < WIDTH; ++column) {
  const place = { clientX: box.left + (column + 0.5) / WIDTH * box.width,
    clientY: box.top + (row + 0.5) / HEIGHT * box.height, bubbles: true };
  frame.dispatchEvent(new PointerEvent("pointermove", place));
  found.push(told.textContent);
}
wiper.value = 30;
wiper.oninput();
const shown = [...frame.querySelectorAll("img:not([hidden])")];
const views = shown.map((picture) => [picture.dataset.view, picture.style.clipPath]);
const fits = document.documentElement.scrollWidth <= innerWidth;
for (const altKey of [false, true])  // with Alt the browser goes back
  document.body.dispatchEvent(
    new KeyboardEvent("keydown", { key: "ArrowRight", altKey, bubbles: true }));
const image = document.querySelector(".image").value;
const said = JSON.stringify({ found, views, fits, image });
document.body.innerHTML = `<pre id=said>${said}</pre>`;
})</script>"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 500])  # Chromium has no narrower window
def test_a_browser_runs_the_page(finished, tmp_path, width):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if not browser:
        pytest.skip("no Chromium")
    page = finished[0] / "report" / "index.html"
    options = ("--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},900")

    def shown(page: Path) -> str:
        made = [browser, *options, "--dump-dom", page.as_uri()]
        return subprocess.run(made, capture_output=True, text=True, timeout=60).stdout

    text = shown(page)
    pressed = re.findall(r'data-choose="(\w+)" aria-pressed="(\w+)"', text)
    assert pressed == [("depth", "true"), ("image", "false"), ("class", "false")]
    assert text.count('class="ego"') == 1

    depth = read_depth(min((finished[0] / "depth").glob("*.png")))
    used = tmp_path / "used.html"
    size = _USED.replace("WIDTH", str(depth.shape[1])).replace("HEIGHT", str(depth.shape[0]))
    used.write_text(page.read_text(encoding="utf-8") + size, encoding="utf-8")
    said = json.loads(re.search(r"id=.?said.?>(.*?)</pre>", shown(used), re.S)[1])
    assert said["fits"]
    assert said["image"] == "1"
    assert said["views"] == [["depth", "inset(0px 0px 0px 30%)"], ["image", ""]]
    values = [np.nan if text == "no depth" else float(text[:-2]) for text in said["found"]]
    assert np.allclose(np.reshape(values, depth.shape), depth, atol=0.0051, equal_nan=True)


def test_images_that_the_page_does_not_hold_are_files_beside_it(finished, monkeypatch, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    monkeypatch.setattr(report_images, "IMAGES", 2)
    page = Page(report(RunFolder.open(run)))
    files = re.findall(r"class=name data-of=(\d) [^>]*data-file=\"([^\"]*)\"", page.text)
    assert {k for k, _ in page.images} == {"0", "3"}
    assert [bool(file) for _, file in files] == [False, True, True, False]
    assert all((run / "report" / file).is_file() for _, file in files if file)
