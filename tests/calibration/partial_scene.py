import numpy as np

from catfree.types import Rig, Scene


def without_camera(scene, camera):
    """Unregister one camera of a scene, with NaN pose; also return which are registered."""
    rig = scene.rig
    t = np.array(rig.t)
    t[camera] = np.nan
    known = np.arange(rig.camera_count) != camera
    partial = Rig(rig.K, rig.R, t, rig.image_size, registered=known)
    return Scene(partial, scene.ground, scene.extent), known
