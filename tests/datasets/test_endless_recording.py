"""A drive that is made while it is read is a recording like any other."""

from importlib.metadata import EntryPoint

import pytest
import yaml
from conformance import check

from docdepth.datasets import open_dataset, registry
from docdepth.errors import DatasetError


@pytest.mark.slow
def test_it_is_a_recording(tmp_path, monkeypatch):
    file = tmp_path / "street.endless.yaml"
    about = {"sensor": "VLP-16", "columns": 90, "frames": 6, "image_every": 3, "image_scale": 0.5}
    file.write_text(yaml.safe_dump(about))
    point = EntryPoint("endless", "scenes.endless:FORMAT", "docdepth.datasets")
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    recording = open_dataset(file)
    check(recording, "endless")
    assert not recording.sweep(3).motion_compensated
    stream = recording.cameras["image_2"]
    assert (stream.names, stream.camera.width) == (["000001", "000004"], 621)
    file.write_text("sensor: none")
    with pytest.raises(DatasetError, match="VLP-16"):
        open_dataset(file)
    file.write_text("length: 3")
    with pytest.raises(DatasetError, match="image_every"):
        open_dataset(file)
