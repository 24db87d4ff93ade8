import numpy as np

from catfree.types import Rig, Scene


def without_camera(scene, camera):
    """The scene with a camera that is not registered and has no place, and which are."""
    rig = scene.rig
    t = np.array(rig.t)
    t[camera] = np.nan
    known = np.arange(rig.camera_count) != camera
    partial = Rig(rig.K, rig.R, t, rig.image_size, registered=known)
    return Scene(partial, scene.ground, scene.extent), known
