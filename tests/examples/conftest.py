"""Example scripts as modules, and small worlds in files for them."""

import importlib.util
import json
from pathlib import Path

import pytest

from catfree.synthetic import make_world
from catfree.synthetic._layouts import ring
from catfree.synthetic.render import render_videos

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="session")
def load_example():
    """Load an example's module by name."""

    def load(name):
        specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def write_sequence(tmp_path_factory):
    """Write a simulated sequence in meters as uniform JSON; every 40th frame number is used."""

    def write(frames, people):
        world = make_world("ring4", 3, frames=frames, people=people)
        rig, seen = world.true_rig, world.detections
        cameras = [
            {
                "name": f"C{c}",
                "K": rig.K[c].tolist(),
                "dist": [0.0] * 5,
                "R": rig.R[c].tolist(),
                "t": rig.t[c].tolist(),
                "width": 1920,
                "height": 1080,
            }
            for c in range(4)
        ]
        instants = []
        for frame in range(frames):
            views = {
                f"C{c}": [
                    {"box": box.tolist()}
                    for box in seen.box[(seen.frame == frame) & (seen.camera == c)]
                ]
                for c in range(4)
            }
            truth = world.ground_truth[world.ground_truth[:, 0] == frame]
            present = [{"id": int(i), "x": x, "y": y} for _, i, x, y in truth.tolist()]
            instants.append({"frame": 40 * frame, "gt": present, "views": views})
        x_min, x_max, y_min, y_max = world.area
        document = {
            "name": "square",
            "units": "m",
            "fps": 5.0,
            "cameras": cameras,
            "frames": instants,
            "evaluation_area": {"x": [x_min, x_max], "y": [y_min, y_max]},
        }
        path = tmp_path_factory.mktemp("sequence") / "square.json"
        path.write_text(json.dumps(document))
        return path

    return write


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """Render videos of three cameras with a few walkers; also return the world."""
    layout = ring(3, image_size=(640, 360), people=5)
    world = make_world(layout, frames=60, people=5, standing=0.0)
    paths = render_videos(world, tmp_path_factory.mktemp("rendered"), workers=1, shadows="soft")
    return [str(path) for path in paths], world
