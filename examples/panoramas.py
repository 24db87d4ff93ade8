"""Track people with panoramic cameras that are described only by their rays.

    python examples/panoramas.py

A panorama (equirectangular, 360 x 180 degrees) is neither a pinhole nor a fisheye, but any camera
is defined by the ray of each pixel. `panorama` below is such a ray source; a look-up table or the
ray map of a network also works. The people and their boxes are simulated: replace `detections` with
those of your detector.
"""

import argparse

import numpy as np

import catfree as cf
from catfree.synthetic import Layout, make_world

SIZE = (3840, 1920)
HALF = np.array([6.0, 4.5])  # meters: half the sides of the room
METHODS = {"evidence": cf.Settings(), "paper": cf.Settings.paper()}


def panorama(camera: int, pixels: np.ndarray) -> np.ndarray:
    """Return panorama rays: columns are longitudes, rows latitudes; x right, y down, z ahead."""
    longitude = ((pixels[:, 0] + 0.5) / SIZE[0] - 0.5) * 2 * np.pi
    latitude = ((pixels[:, 1] + 0.5) / SIZE[1] - 0.5) * np.pi
    level = np.cos(latitude)
    return np.stack([level * np.sin(longitude), np.sin(latitude), level * np.cos(longitude)], -1)


def room() -> cf.Rig:
    """Place four level panoramas on the walls, 2.7 m high, with their seams towards the wall."""
    center = np.array([[-1, -0.9], [1, -0.7], [1, 0.9], [-1, 0.7]]) * (HALF + 0.5)
    ahead = -center / np.linalg.norm(center, axis=-1, keepdims=True)
    R = np.zeros((4, 3, 3))
    R[:, 0, 0], R[:, 0, 1] = ahead[:, 1], -ahead[:, 0]
    R[:, 1, 2] = -1
    R[:, 2, :2] = ahead
    place = np.column_stack([center, np.full(4, 2.7)])
    return cf.rig_from_rays(panorama, R, -np.einsum("cij,cj->ci", R, place), SIZE)


def main() -> None:
    """Simulate people in the room, and localize them with both methods."""
    parser = argparse.ArgumentParser(description="Track people with panoramic cameras.")
    parser.add_argument("--frames", type=int, default=50, help="frames to simulate")
    parser.add_argument("--people", type=int, default=6, help="people in the room")
    options = parser.parse_args()
    (x, y), people = HALF, options.people
    layout = Layout("room", room(), (-x, x, -y, y), 5.0, people)
    world = make_world(layout, frames=options.frames, background=0)
    frame, _, *truth = np.asarray(world.ground_truth).T
    for name, settings in METHODS.items():
        tracks = cf.localize(world.detections, world.true_scene, settings).tracks
        position = np.asarray(tracks.position)[:, :2]
        apart = [
            np.linalg.norm(np.stack(truth, -1)[frame == f] - p, axis=-1).min()
            for f, p in zip(tracks.frame, position, strict=True)
        ]
        print(
            f"{name}: {len(tracks)} positions of {len(frame)}, "
            f"median error {np.median(apart):.2f} m"
        )


if __name__ == "__main__":
    main()
