"""Arrays that may live on the host or on the device."""

import numpy as np
from jaxtyping import Array

HostOrDevice = np.ndarray | Array
