"""Draw what catfree can show, in a simulated world.

    python examples/gallery.py --out pictures

Write the pictures of the documentation: tracks from above, coverage, the ground in a camera's
picture, and boxes and identities on a frame.
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

import catfree as cf
from catfree.synthetic.render import make_demo_world, render_videos

FRAME = 20
SIZE = (800, 450)
WIDTH = 720  # of a plot in pixels


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("pictures"), help="folder")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)

    world = make_demo_world(0, cameras=5, people=8, frames=2 * FRAME, image_size=SIZE)
    scene = world.true_scene
    boxes = world.detections
    result = cf.localize(boxes, scene)

    axes = cf.viz.plot_bird_eye(result, scene, area=world.area)
    save(axes, out / "bird_eye.png")
    coverage = cf.coverage(scene, area=(-12, 12, -12, 12))
    save(cf.viz.plot_coverage(coverage, scene), out / "coverage.png")

    picture = render_frame(world)
    grid = cf.viz.draw_ground_grid(picture, scene, 0)
    overlay = cf.viz.draw_frame(picture, 0, FRAME, boxes, result, scene)
    for name, image in (("ground_grid.jpg", grid), ("overlay.jpg", overlay)):
        cv2.imwrite(str(out / name), image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
    print("\n".join(sorted(path.name for path in out.iterdir())))


def save(axes, path: Path) -> None:
    """Write the figure of some axes as a small PNG and close it."""
    axes.figure.savefig(path, dpi=WIDTH / axes.figure.get_figwidth())
    plt.close(axes.figure)


def render_frame(world) -> np.ndarray:
    """Render the first camera of the world and return one of its frames, RGB."""
    alone = dataclasses.replace(world, true_rig=world.true_rig.select([0]))
    with tempfile.TemporaryDirectory() as folder:
        (video,) = render_videos(alone, folder, workers=1)
        capture = cv2.VideoCapture(str(video))
        capture.set(cv2.CAP_PROP_POS_FRAMES, FRAME)
        picture = capture.read()[1]
        capture.release()
    return np.ascontiguousarray(picture[:, :, ::-1])


if __name__ == "__main__":
    main()
