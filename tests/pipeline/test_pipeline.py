"""A whole run on a small synthetic drive: files, cameras, resume."""

from __future__ import annotations

import json
import re
import shutil

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.geometry.track import Tracks
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks, tracks_in
from docdepth.pipeline import depth_files, sweep_store
from docdepth.visualization import pictures as visualize
from docdepth.visualization.video import sweep_from_above
from small_drive import HEIGHT, WIDTH, write_small_drive

FRAMES = 5


def test_images_in_a_gap_get_no_depth(tmp_path):
    """Nobody knows where the camera was while the LiDAR was silent."""
    drive, run = write_small_drive(tmp_path / "drive", 6), tmp_path / "run"
    (drive / "times.txt").write_text("0\n0.1\n0.2\n5\n5.1\n5.2\n")
    (drive / "image_2" / "times.txt").write_text("-1\n0.1\n0.2\n2\n5\n5.1\n")
    for _ in range(2):  # the second time all is done
        assert cli("run", drive, "-o", run, "--camera", "image_2").exit_code == 0
        assert sorted(p.stem for p in (run / "depth").glob("*.png")) == [
            *("000001", "000002", "000004", "000005")
        ]
        assert RunFolder(run).stage("render image_2").left_out == ("000000", "000003")


def test_outputs_of_a_run(drive, finished):
    run, output = finished
    names = [p.stem for p in sorted((drive / "image_2").glob("*.png"))]
    inside = [p.stem for p in sorted((run / "depth").glob("*.png"))]
    left_out = RunFolder(run).stage("render image_2").left_out
    assert sorted([*inside, *left_out]) == names
    assert inside
    for name in inside:
        depth = cv2.imread(str(run / "depth" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        assert depth.shape == (HEIGHT, WIDTH)
        assert (depth > 0).mean() > 0.2
        assert (run / "report" / f"{name}.jpg").is_file()
    tracks = {track.id for track in read_tracks(run / "tracks.csv")}
    assert tracks
    for sweep in sorted((drive / "velodyne").glob("*.bin")):
        rows = sweep.stat().st_size // 16
        labels = np.fromfile(run / "labels" / f"{sweep.stem}.label", np.uint32)
        assert len(labels) == rows
        assert set(np.unique(labels & 0xFFFF)) <= {9, 251}
        followed = labels[labels >> 16 > 0]
        assert set((followed & 0xFFFF).tolist()) <= {251}
        assert set((followed >> 16).tolist()) <= tracks
    for name in ("traj_odometry.ply", "traj_camera.ply", "calib.json", "calib_lidar_ref_cam.txt"):
        assert (run / name).is_file()
    assert not list(run.rglob("*.part"))
    page = (run / "report" / "index.html").read_text()
    shown = re.findall(r"<span class=name[^>]*>image (\w+) at", page)
    assert shown == inside
    assert str(drive) in page
    if left_out:
        assert f"{len(left_out)} images outside" in output


def test_interrupted_run_goes_on_and_ends_the_same(drive, finished, tmp_path, monkeypatch):
    run = tmp_path / "run"
    written = []

    def stop_after(function, count):
        def wrapped(*arguments):
            written.append(arguments[0])
            if len(written) == count:
                raise KeyboardInterrupt
            return function(*arguments)

        return wrapped

    for module, name, count in (
        (sweep_store, "write_classified", 3),
        (depth_files, "encode_image", 2),
    ):
        written.clear()
        with monkeypatch.context() as patch:
            patch.setattr(module, name, stop_after(getattr(module, name), count))
            assert cli("run", drive, "-o", run).exit_code != 0
    before = {p: p.stat().st_mtime_ns for p in (run / "labels").iterdir()}
    assert cli("run", drive, "-o", run).exit_code == 0
    assert {p: p.stat().st_mtime_ns for p in (run / "labels").iterdir()} == before
    for folder in ("frames", "classes", "labels", "depth"):
        for path in sorted((finished[0] / folder).iterdir()):
            assert path.read_bytes() == (run / folder / path.name).read_bytes(), path.name


def test_several_cameras_in_several_formats(drive, finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    arguments = ("--camera", "image_2,image_3", "--format", "png,npz", "--format", "tiff")
    result = cli("render", run, *arguments, "--scale", 64, "--set", "render.max_depth=700")
    assert result.exit_code == 0, result.output
    # The first camera keeps its folder, the second has its own.
    folders = {"image_2": run / "depth", "image_3": run / "depth" / "image_3"}
    before = read_depth(finished[0] / "depth" / "000001.png")
    for camera in ("image_2", "image_3"):
        text = json.loads((folders[camera] / "depth.json").read_text())
        assert text["scale"] == {"png": 64.0, "npz": 1, "tiff": 1}
        assert text["range"] == [0.1, 700.0]
        assert text["camera"]["name"] == camera
        assert len(text["maps"]) >= FRAMES - 1
        for name, known in text["maps"].items():
            path = folders[camera] / name
            png, npz, tiff = (read_depth(path.with_suffix(s)) for s in (".png", ".npz", ".tiff"))
            np.testing.assert_array_equal(npz, tiff)
            np.testing.assert_allclose(png, npz, atol=0.51 / 64)
            assert known["coverage"] == pytest.approx(np.isfinite(npz).mean(), abs=1e-6)
            pictures = run / "report" / folders[camera].relative_to(run / "depth")
            assert (pictures / f"{name}.jpg").is_file()
    known = RunFolder(run).calibration("image_3")
    np.testing.assert_allclose(known[1], open_dataset(drive).cameras["image_3"].T_camera_lidar)
    left, right = (read_depth(folder / "000001.npz") for folder in folders.values())
    np.testing.assert_allclose(left, before, atol=0.51 / 256)
    assert not np.array_equal(left, right, equal_nan=True)
    assert list(open_dataset(run).cameras) == ["camera", "image_3"]
    result = cli("evaluate", "depth", run, "--depth", drive)
    assert "image_2, image_3: say `camera`" in str(result.exception)
    result = cli("evaluate", "depth", run, "--depth", drive, "--camera", "image_2", "--json")
    assert json.loads(result.stdout)["all"]["mae"] < 3

    # One of them again, in another format: the other stays as it is.
    untouched = {p: p.stat().st_mtime_ns for p in folders["image_3"].iterdir()}
    assert cli("render", run, "--camera", "image_2", "--format", "png").exit_code == 0
    assert read_depth(run / "depth" / "000001.png").shape == before.shape
    assert not list((run / "depth").glob("*.npz"))
    assert {p: p.stat().st_mtime_ns for p in folders["image_3"].iterdir()} == untouched


def test_layers_beside_depth(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    assert cli("render", run, "--layers", "class,time", "--layers", "support").exit_code == 0
    names = [p.stem for p in sorted((run / "depth").glob("*.png"))]
    assert [p.stem for p in sorted((run / "layers").iterdir())] == names
    for name in names:  # depth is the same with and without
        png = run / "depth" / f"{name}.png"
        assert png.read_bytes() == (finished[0] / "depth" / png.name).read_bytes()
        layers = np.load(run / "layers" / f"{name}.npz")
        assert list(layers) == ["class", "time", "support"]
        none = np.isnan(read_depth(png))
        np.testing.assert_array_equal(layers["class"] == 255, none)
        np.testing.assert_array_equal(np.isnan(layers["time"]), none)
    # One more layer is drawn of the depth that is there, as if all had been asked for at once.
    kept = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in (run / "depth").glob("*.png")}
    assert cli("run", run, "--layers", "class,time,support,std").exit_code == 0
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in kept} == kept
    for name in names:
        more = np.load(run / "layers" / f"{name}.npz")
        assert list(more) == ["class", "time", "support", "std"]
        shutil.copy(run / "layers" / f"{name}.npz", tmp_path)
    assert "std" in json.loads((run / "depth" / "depth.json").read_text())["layers"]
    for folder in ("depth", "layers"):
        shutil.rmtree(run / folder)
    assert cli("run", run).exit_code == 0
    for name in names:
        one, other = (np.load(place / f"{name}.npz") for place in (tmp_path, run / "layers"))
        assert all(np.array_equal(one[k], other[k], equal_nan=k != "class") for k in one)
    # A map whose layers are missing is not whole.
    (run / "layers" / f"{names[0]}.npz").unlink()
    assert cli("render", run).exit_code == 0
    assert (run / "layers" / f"{names[0]}.npz").is_file()
    assert cli("render", run, "--set", "output.layers=[]").exit_code == 0
    assert not (run / "layers").exists()
    result = cli("render", run, "--layers", "colour")
    assert result.exit_code == 2
    assert "colour" in result.output


@pytest.mark.parametrize("ending", ["webm", "mp4"])
def test_video_of_a_run(drive, finished, tmp_path, monkeypatch, ending):
    if ending == "mp4":
        pytest.importorskip("imageio_ffmpeg")
    call = ("video", tmp_path / "run", *(["--mp4"] if ending == "mp4" else []))
    run, video = tmp_path / "run", tmp_path / "run" / "report" / f"video.{ending}"
    shutil.copytree(finished[0], run)
    assert cli(*call).exit_code == 0
    reader = cv2.VideoCapture(str(video))
    names = [p.stem for p in sorted((run / "depth").glob("*.png"))]
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == len(names)
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(10, abs=0.1)
    for name in names:
        whole, frame = reader.read()
        assert whole
        assert frame.shape == (2 * HEIGHT, WIDTH, 3)
        image = cv2.imread(str(drive / "image_2" / f"{name}.png"))
        assert np.abs(frame[:HEIGHT].astype(int) - image).mean() < 12
        colours = visualize.colorize(read_depth(run / "depth" / f"{name}.png"))
        assert np.abs(frame[HEIGHT:].astype(int) - colours).mean() < 12
    before = video.read_bytes()
    if ending == "mp4":  # as players need it: H.264 of half the colours, the index before the data
        assert reader.get(cv2.CAP_PROP_FOURCC) == cv2.VideoWriter.fourcc(*"h264")
        assert reader.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT) == cv2.VideoWriter.fourcc(*"I420")
        assert before.index(b"moov") < before.index(b"mdat")
    with monkeypatch.context() as patch:  # a full disk, as OpenCV tells it: not at all
        patch.setattr(cv2.VideoWriter, "write", lambda *_: None)
        patch.setattr("docdepth.visualization.video._H264.write", lambda *_: None)
        result = cli(*call)
    assert result.exit_code == 2
    assert "make room" in str(result.exception)
    assert video.read_bytes() == before
    assert not list(run.rglob(".video*"))
    (run / "depth" / f"{names[1]}.png").unlink()
    assert f"depth/{names[1]}.png is missing" in str(cli(*call).exception)
    assert "not of image_7" in str(cli("video", run, "--camera", "image_7").exception)


def test_video_from_above_shows_points_and_tracks_where_they_are(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    assert cli("video", run, "--above").exit_code == 0
    reader = cv2.VideoCapture(str(run / "report" / "above.webm"))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    for _ in range(3):
        whole, frame = reader.read()
    assert whole
    folder = RunFolder.open(run)
    record, classid = folder.classified_frame(2)
    trajectory = folder.trajectory()
    pose, time = trajectory.poses[2], int(trajectory.times[2])
    exact = sweep_from_above(folder, trajectory, Tracks(), 2)
    tracks = tracks_in(run)
    assert tracks.between(time, time)
    boxed = sweep_from_above(folder, trajectory, tracks, 2)
    assert np.abs(frame.astype(int) - boxed).mean() < 6

    def pixel(world):  # 100 m are 1280 pixels; x to the right, y up, the LiDAR in the middle
        x, y = (world[:2] - pose[:2, 3]) * 12.8
        return round(480 - y), round(640 + x)

    moving = np.flatnonzero(classid >= 100)
    places = [pixel(pose[:3, :3] @ record.points[k] + pose[:3, 3]) for k in moving]
    inside = [(r, c) for r, c in places if 40 < r < 900 and 200 < c < 1100]
    orange = [tuple(exact[place]) == visualize.DYNAMIC_COLOR for place in inside]
    assert np.mean(orange) > 0.9
    assert cli("video", run, "--above", "--camera", "image_2").exit_code == 2
    changed = (exact != boxed).any(axis=2)
    for track in tracks.between(time, time):
        T = track.pose_at(time)
        row, column = pixel(T[:3, 3] + T[:3, 0] * track.size[0] / 2)  # the middle of the front
        if 0 < row < 960 and 0 < column < 1280:
            assert changed[row - 1 : row + 2, column - 1 : column + 2].any()


def test_distorted_images_are_rectified_under_the_depth(drive, finished, tmp_path):
    camera = open_dataset(drive).cameras["image_2"]
    distorted = tmp_path / "drive"
    shutil.copytree(drive, distorted)
    (distorted / "image_2" / "distortion.txt").write_text("-0.3 0.1 0 0.001")
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    K, k = camera.camera.K, np.array([-0.3, 0.1, 0, 0.001])
    ray = np.array([[0.6, 0.1, 1.0]])  # one bright point, where the lens puts it
    (u, v) = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), K, k)[0].ravel().round().astype(int)
    image[v - 1 : v + 2, u - 1 : u + 2] = 255
    path = distorted / "image_2" / "000001.png"
    cv2.imwrite(str(path), image)
    stream = open_dataset(distorted).cameras["image_2"]
    rectified = stream.rectified_image(stream.names.index("000001"))
    row, column = np.argwhere(rectified.max(axis=2) > 128).mean(axis=0)
    straight = K @ ray[0]
    assert abs(column - straight[0]) < 1.5
    assert abs(row - straight[1]) < 1.5
    assert abs(column - u) > 2

    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    folder = RunFolder(run)
    folder.manifest.inputs = folder.inputs.but(recording=distorted)
    folder.save()
    assert cli("render", run).exit_code == 0
    known = json.loads((run / "depth" / "depth.json").read_text())["camera"]
    assert known["distortion_of_images"] == [-0.3, 0.1, 0, 0.001]
    assert json.loads((run / "calib.json").read_text())["dist"] == [-0.3, 0.1, 0, 0.001]
    for name in ("000001.png", "000002.png"):  # depth is of the rectified camera, as before
        assert (run / "depth" / name).read_bytes() == (finished[0] / "depth" / name).read_bytes()


def test_virtual_camera_beside_the_run(drive, finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    stream = open_dataset(drive).cameras["image_2"]
    before = {p.name: p.read_bytes() for p in (run / "depth").glob("*")}
    parameters = RunFolder(run).parameters
    K = ",".join(repr(float(stream.camera.K[i])) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    times = tmp_path / "times.txt"
    inside = [t for t in stream.times if t <= open_dataset(drive).times[-1]]
    times.write_text("".join(f"{t // 10**9}.{t % 10**9:09d}\n" for t in inside))
    pose = tmp_path / "pose.txt"
    np.savetxt(pose, np.linalg.inv(stream.T_camera_lidar))
    mounted = ("--K", K, "--size", f"{WIDTH}x{HEIGHT}", "--format", "npy")
    result = cli("render", run, "--pose", pose, *mounted, "--camera-times", times, "--name", "twin")
    assert result.exit_code == 0, result.output
    # Where a camera of the rig is, it sees what that sees.
    for k, name in enumerate(sorted(n for n in before if n.endswith(".png"))):
        twin = read_depth(run / "depth" / "twin" / f"{k:010d}.npy")
        np.testing.assert_allclose(twin, read_depth(finished[0] / "depth" / name), atol=0.51 / 256)
    # At the stamps of the sweeps, looking backwards along the road.
    backwards = "0,0,0.5,-0.5,-0.5,0.5,0.5"
    result = cli("render", run, "--pose", backwards, *mounted, "--name", "back")
    assert result.exit_code == 0, result.output
    known = json.loads((run / "depth" / "back" / "depth.json").read_text())
    assert list(known["maps"]) == [f"{k:06d}" for k in range(FRAMES)]
    T_camera_lidar = np.array(known["camera"]["T_camera_lidar"])
    np.testing.assert_allclose(T_camera_lidar @ [-10, 0, 0.5, 1], [0, 0, 10, 1], atol=1e-9)
    np.testing.assert_allclose(T_camera_lidar @ [-10, 1, 0.5, 1], [1, 0, 10, 1], atol=1e-9)
    # The run itself is as it was.
    assert {p.name: p.read_bytes() for p in (run / "depth").glob("*.*")} == before
    assert RunFolder(run).parameters == parameters
    assert cli("run", drive, "-o", run).exit_code == 0
