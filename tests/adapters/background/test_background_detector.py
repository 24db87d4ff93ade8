from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import linear_sum_assignment

from catfree.adapters import BackgroundDetector, Detector, FittedToCamera, GuidedDetector
from catfree.adapters.background._background_model import (
    MAXIMUM_SAMPLES,
    Foreground,
    PictureSamples,
)
from catfree.adapters.background._blob_grouping import group_blobs
from catfree.adapters.background._blob_splitting import Expected, split_blob
from catfree.adapters.background._height_profile import Blobs, HeightProfile, fit_height_profile
from catfree.adapters.detectors._box_suppression import box_overlap
from catfree.errors import InsufficientDataError, InvalidInputError

pytestmark = pytest.mark.slow

# A small drawn world: one static camera 4.5 m above a paved square, shaded people with walking
# legs and cast shadows, sensor noise and JPEG coding.

WIDTH, HEIGHT = 640, 360
FOCAL, CAMERA_HEIGHT, TILT = 470.0, 4.5, np.radians(22)
SHADE = 0.55


def axes():
    """Return the world-to-camera rotation: x right, y down, z forward; world z up, y forward."""
    s, c = np.sin(TILT), np.cos(TILT)
    return np.array([[1, 0, 0], [0, -s, -c], [0, c, -s]])


def project(points):
    camera = (np.asarray(points, float) - [0, 0, CAMERA_HEIGHT]) @ axes().T
    return camera[..., :2] / camera[..., 2:] * FOCAL + [WIDTH / 2, HEIGHT / 2]


def paved_square(rng):
    """Draw the empty scene: slabs with different tone and grain, and a wall behind."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones(u.shape)], -1)
    world = rays @ axes()
    depth = CAMERA_HEIGHT / np.maximum(-world[..., 2], 1e-6)
    x, y = world[..., 0] * depth, world[..., 1] * depth
    slab = rng.uniform(0.85, 1.1, (64, 64))[
        np.floor(x).astype(int) % 64, np.floor(y).astype(int) % 64
    ]
    joint = ((x % 1 < 0.05) | (y % 1 < 0.05)) & (y < 30)
    grain = cv2.GaussianBlur(rng.normal(0, 30, (HEIGHT, WIDTH)), (0, 0), 1.2)
    tone = 150 * slab * np.where(joint, 0.75, 1) + grain
    image = tone[..., None] * [1.0, 0.97, 0.92]
    wall = (y > 30) | (world[..., 2] >= -1e-6)
    image[wall] = ([150, 110, 90] + grain[..., None])[wall]
    return image


class Walker:
    def __init__(self, rng):
        self.height, self.phase = rng.normal(1.72, 0.08), rng.uniform(0, 6.28)
        self.start = rng.uniform([-5, 7], [5, 17])
        self.velocity = rng.normal(0, 0.22, 2)
        self.shirt, self.trousers = rng.uniform(20, 235, (2, 3))
        self.trousers = self.trousers * 0.6
        self.skin = np.array([200, 150, 120]) * rng.uniform(0.5, 1.1)
        self.hair = rng.uniform(20, 90) * np.ones(3)

    def position(self, time):
        """Walk back and forth in the square."""
        low, span = np.array([-5.5, 6.5]), np.array([11.0, 11.5])
        turn = (self.start + self.velocity * time - low) % (2 * span)
        return low + np.minimum(turn, 2 * span - turn)

    def silhouette(self, time):
        """Return foot and head pixel, and colored polygons in heights, x right and y up."""
        x, y = self.position(time)
        swing = 0.1 * np.sin(self.phase + 1.3 * time)
        foot, head = project([[x, y, 0], [x, y, self.height]])
        legs = [
            [(-0.07, 0.5), (0.0, 0.5), (s + 0.03, 0.0), (s - 0.045, 0.0)]
            for s in (-0.02 - swing, 0.02 + swing)
        ]
        legs[1] = [(p[0] + 0.07 * (p[1] > 0.1), p[1]) for p in legs[1]]
        shoes = [[(a - 0.05, 0.03), (a + 0.05, 0.03), (a + 0.05, 0.0), (a - 0.05, 0.0)]
                 for a in (-0.02 - swing, 0.02 + swing)]  # fmt: skip
        torso = [(-0.1, 0.82), (0.1, 0.82), (0.12, 0.6), (0.1, 0.48), (-0.1, 0.48), (-0.12, 0.6)]
        arms = [
            [(s * 0.1, 0.8), (s * 0.15, 0.75), (s * 0.17, 0.48), (s * 0.12, 0.48)] for s in (-1, 1)
        ]
        angle = np.linspace(0, 2 * np.pi, 17)
        face = np.stack([0.055 * np.cos(angle), 0.925 + 0.075 * np.sin(angle)], -1)
        hair = np.stack([0.055 * np.cos(angle / 2), 0.95 + 0.05 * np.sin(angle / 2)], -1)
        parts = [(leg, self.trousers) for leg in legs] + [(s, np.full(3, 35.0)) for s in shoes]
        parts += [(torso, self.shirt)] + [(arm, self.shirt * 0.9) for arm in arms]
        parts += [(face, self.skin), (hair, self.hair)]
        return foot, head, parts


def draw(background, walkers, time, rng, shadows=True, reach=(0.75, 0.35), blur=1.0):
    """Draw a picture; also return the whole box of each walker, and how much of each is seen."""
    canvas = background.copy()
    order = np.argsort([-w.position(time)[1] for w in walkers])
    if shadows:
        shade = np.zeros((HEIGHT, WIDTH), np.float32)
        for walker in walkers:
            x, y = walker.position(time)
            along = np.array(reach) * walker.height
            side = np.array([-along[1], along[0]]) / np.linalg.norm(along) * 0.17
            outline = [(0, -0.5), (0, 0.5), (0.6, 1.2), (1, 0.5), (1, -0.5), (0.6, -1.2)]
            ground = [np.array([x, y]) + a * along + b * side for a, b in outline]
            polygon = project([[*p, 0] for p in ground])
            cv2.fillPoly(shade, [np.round(polygon * 16).astype(np.int32)], 1.0, cv2.LINE_AA, 4)
        canvas *= 1 - (1 - SHADE) * cv2.GaussianBlur(shade, (0, 0), blur)[..., None]
    owner = np.full((HEIGHT, WIDTH), -1)
    boxes, areas = np.zeros((len(walkers), 4)), np.zeros(len(walkers))
    for index in order:
        foot, head, parts = walkers[index].silhouette(time)
        tall = foot[1] - head[1]
        shapes = [foot + np.asarray(polygon) * [tall, -tall] for polygon, _ in parts]
        points = np.concatenate(shapes)
        boxes[index] = low_x, low_y, high_x, high_y = [*points.min(0), *points.max(0)]
        x1, y1 = max(0, int(low_x) - 1), max(0, int(low_y) - 1)
        x2, y2 = min(WIDTH, int(high_x) + 2), min(HEIGHT, int(high_y) + 2)
        if x1 >= x2 or y1 >= y2:
            areas[index] = 1
            continue
        patch, drawn = canvas[y1:y2, x1:x2], np.zeros((y2 - y1, x2 - x1), np.uint8)
        shading = 1.15 - 0.4 * np.clip((np.arange(x1, x2) - foot[0]) / (0.3 * tall) + 0.5, 0, 1)
        for shape, (_, colour) in zip(shapes, parts, strict=True):
            mask = np.zeros_like(drawn)
            cv2.fillPoly(mask, [np.round((shape - [x1, y1]) * 16).astype(np.int32)], 1, 8, 4)
            patch[mask > 0] = (colour * shading[None, :, None] * np.ones((y2 - y1, 1, 1)))[mask > 0]
            drawn |= mask
        owner[y1:y2, x1:x2][drawn > 0] = index
        areas[index] = max(drawn.sum(), 1)
    seen = np.array([(owner == i).sum() for i in range(len(walkers))]) / areas
    inside = (boxes[:, 0] > 0) & (boxes[:, 2] < WIDTH - 1) & (boxes[:, 3] < HEIGHT - 1)
    noisy = np.clip(canvas + rng.normal(0, 2.5, canvas.shape), 0, 255).astype(np.uint8)
    coded = cv2.imencode(".jpg", noisy[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
    return (
        cv2.imdecode(coded, cv2.IMREAD_COLOR)[:, :, ::-1].copy(),
        boxes,
        np.where(inside, seen, -1),
    )


def film(people, frames=120, seed=0, shadows=True):
    """Yield (picture, boxes, visible shares) of each frame, one per second."""
    rng = np.random.default_rng(seed)
    background, walkers = paved_square(rng), [Walker(rng) for _ in range(people)]
    return [draw(background, walkers, float(t), rng, shadows) for t in range(frames)]


# Measured on the drawn world.


@pytest.fixture(scope="module")
def street():
    """Draw twelve people for 100 frames, and fit a detector to them."""
    frames = film(12, frames=100)
    return frames, BackgroundDetector().fit(image for image, _, _ in frames)


def matches(truth, found):
    overlap = box_overlap(truth.astype(np.float32), found.box)
    rows, columns = linear_sum_assignment(-overlap)
    good = overlap[rows, columns] > 0.5
    return rows[good], columns[good]


def test_recall_precision_and_feet(street):
    frames, detector = street
    seen = found = true = 0
    feet = []
    for image, boxes, share in frames[::2]:
        result = detector(image)
        rows, columns = matches(boxes, result)
        seen += (share > 0.3).sum()
        true += (share[rows] > 0.3).sum()
        found += len(result) - (len(rows) - (share[rows] > 0.3).sum())
        for row, column in zip(rows, columns, strict=True):
            height = boxes[row, 3] - boxes[row, 1]
            if result.score[column] > 0.86:
                feet.append((result.box[column, 3] - boxes[row, 3]) / height)
    assert true / seen >= 0.88
    assert true / found >= 0.96
    assert len(feet) > 100
    assert abs(np.mean(feet)) < 0.02
    assert np.std(feet) < 0.025


def test_knowing_where_people_stand_finds_more_of_them_and_nobody_else(street):
    frames, detector = street
    rng = np.random.default_rng(0)
    found, right, seen = np.zeros(2), np.zeros(2), 0
    for image, boxes, share in frames[::4]:
        height = boxes[:, 3] - boxes[:, 1]
        place = np.stack([(boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3], height], -1)
        place[:, :2] += rng.normal(0, 0.04, (len(boxes), 2)) * height[:, None]
        place[:, 2] *= rng.normal(1, 0.03, len(boxes))
        seen += (share > 0.3).sum()
        for way, result in enumerate((detector(image), detector.look_again(image, place))):
            rows, _ = matches(boxes, result)
            found[way] += len(result)
            right[way] += (share[rows] > 0.3).sum()
    assert right[1] > right[0]
    assert right[1] / seen >= 0.9
    assert right[1] / found[1] > right[0] / found[0] - 0.01


def test_hints_without_anybody_there_change_nothing(street):
    frames, detector = street
    for image, boxes, _ in frames[::20]:
        empty = [[x, 340.0, 120.0] for x in range(20, 640, 40)]
        far = [one for one in empty if np.abs(boxes[:, [0, 2]] - one[0]).min() > 80]
        result, again = detector(image), detector.look_again(image, np.array(far).reshape(-1, 3))
        np.testing.assert_array_equal(again.box, result.box)


def test_shadows_are_not_people_and_do_not_lower_feet(street):
    _, detector = street
    rng = np.random.default_rng(0)
    background, walkers = paved_square(rng), [Walker(rng) for _ in range(12)]
    same = seen = 0
    for time in (3.0, 40.0, 77.0):
        lit, shaded = (
            detector(draw(background, walkers, time, np.random.default_rng(1), shadows)[0])
            for shadows in (False, True)
        )
        pairs = box_overlap(lit.box, shaded.box)
        assert abs(len(lit) - len(shaded)) <= 2
        best = pairs.argmax(axis=1)[pairs.max(axis=1) > 0.7]
        height = np.median(lit.box[:, 3] - lit.box[:, 1])
        moved = shaded.box[best, 3] - lit.box[pairs.max(axis=1) > 0.7, 3]
        assert np.median(np.abs(moved)) < 0.02 * height
        same, seen = same + len(best), seen + len(lit)
    assert same >= 0.9 * seen  # a shadow behind a pair shifts the border between the two


@pytest.mark.parametrize("blur", [1.0, 2.0])
def test_shadows_towards_the_camera_do_not_lower_feet(street, blur):
    """Their blurred rim must not count as a body below them."""
    _, detector = street
    rng = np.random.default_rng(0)
    background, walkers = paved_square(rng), [Walker(rng) for _ in range(12)]
    below = []
    for time in (3.0, 40.0, 77.0):
        picture, boxes, _ = draw(
            background, walkers, time, np.random.default_rng(1), reach=(0.2, -0.8), blur=blur
        )
        found = detector(picture)
        rows, columns = matches(boxes, found)
        assert len(rows) >= 0.6 * len(found)
        height = boxes[rows, 3] - boxes[rows, 1]
        below.append((found.box[columns, 3] - boxes[rows, 3]) / height)
    assert np.median(np.abs(np.concatenate(below))) < 0.02


def test_hair_paler_than_the_face_belongs_to_the_person(street):
    """An edge is where the difference falls to half of its value next to that edge."""
    _, detector = street
    difference = np.zeros((120, 100), np.float32)
    difference[30:90, 40:60] = 100.0
    difference[30:34, 40:60] = 30.0
    foreground = Foreground((difference > 0).astype(np.uint8), difference)
    sixty = replace(detector, profile=HeightProfile(np.array([0.0, 0.0, 60.0])))
    np.testing.assert_array_equal(sixty.find_people(foreground, [])[:, :4], [[40, 30, 60, 90]])


def test_how_dark_shadows_are_is_learned(street):
    """The drawn shadows leave 55 % of the light; darker gray clothes are not a shadow."""
    _, detector = street
    assert np.log(SHADE) - 0.25 < detector.background.darkest < np.log(SHADE)
    rng = np.random.default_rng(0)
    background = paved_square(rng)
    picture = background + rng.normal(0, 2, background.shape)
    for share, column in ((SHADE, 200), (0.6 * SHADE, 420)):
        picture[200:280, column - 20 : column + 20] *= share
    mask = detector.background.compare(np.clip(picture, 0, 255).astype(np.uint8)).mask
    assert mask[205:275, 185:215].mean() < 0.1
    assert mask[205:275, 405:435].mean() > 0.8


def test_the_empty_scene_holds_nobody(street):
    _, detector = street
    rng = np.random.default_rng(0)
    assert len(detector(draw(paved_square(rng), [], 0.0, rng)[0])) == 0


def test_exposure_may_change(street):
    frames, detector = street
    found = again = 0
    for image, _, _ in frames[10:90:10]:
        brighter = np.clip(image.astype(float) * 1.12, 0, 255).astype(np.uint8)
        first, second = detector(image), detector(brighter)
        found += len(first)
        again += (box_overlap(first.box, second.box).max(axis=1) > 0.5).sum()
    assert again / found > 0.85


def test_a_larger_picture_gives_the_same_boxes_in_its_pixels(street):
    frames, detector = street
    doubled = BackgroundDetector().fit(np.kron(f[0], np.ones((2, 2, 1), np.uint8)) for f in frames)
    image = frames[30][0]
    small = detector(image)
    large = doubled(np.kron(image, np.ones((2, 2, 1), np.uint8)))
    np.testing.assert_allclose((large.box + 0.5) / 2 - 0.5, small.box, atol=1e-3)
    np.testing.assert_array_equal(large.score, small.score)


def test_live_pictures_are_learned_from_as_they_come(street):
    frames, fitted = street
    detector = BackgroundDetector()
    found = [len(detector(image)) for image, _, _ in frames[:80]]
    assert found[:7] == [0] * 7
    later = sum(found[64:])
    assert 0.8 < later / sum(len(fitted(image)) for image, _, _ in frames[64:80]) < 1.2


def test_protocols_and_fingerprints(street):
    frames, detector = street
    assert isinstance(BackgroundDetector(), Detector)
    assert isinstance(BackgroundDetector(), FittedToCamera)
    assert isinstance(detector, GuidedDetector)
    assert not isinstance(detector, FittedToCamera)
    again = BackgroundDetector().fit(image for image, _, _ in frames)
    assert again.fingerprint == detector.fingerprint
    other = BackgroundDetector().fit(image for image, _, _ in frames[:50])
    assert other.fingerprint != detector.fingerprint


def test_too_few_pictures_and_another_camera(street):
    frames, detector = street
    with pytest.raises(InsufficientDataError, match="at least 8 pictures"):
        BackgroundDetector().fit(image for image, _, _ in frames[:7])
    with pytest.raises(InvalidInputError, match="one detector"):
        BackgroundDetector().fit([frames[0][0]] * 9 + [frames[0][0][:-20]])
    with pytest.raises(InvalidInputError, match="one detector"):
        detector(frames[0][0][:, :-40])


# Parts of the detector.


@given(st.integers(0, 1000))
def test_samples_spread_evenly_over_a_stream(count):
    samples = PictureSamples()
    for number in range(count):
        samples.add(np.full((1, 1, 3), number % 251, np.uint8))
    taken = len(samples.pictures)
    assert taken == count if count <= MAXIMUM_SAMPLES else taken > MAXIMUM_SAMPLES / 2 - 1
    assert taken <= MAXIMUM_SAMPLES
    steps = {(int(b[0, 0, 0]) - int(a[0, 0, 0])) % 251 for a, b in pairwise(samples.pictures)}
    assert len(steps) <= 1


@given(
    st.floats(0.05, 0.5),
    st.floats(-0.03, 0.03),
    st.floats(10, 40),
    st.integers(0, 2**31 - 1),
)
def test_the_height_profile_survives_groups(slope, lean, base, seed):
    """A third of the silhouettes are groups of other heights."""
    random = np.random.default_rng(seed)
    u, v = random.uniform(50, 600, 60), random.uniform(100, 350, 60)
    height = slope * v + lean * u + base
    height[:20] *= random.choice([0.6, 1.7], 20)
    boxes = np.stack([u - 0.2 * height, v - height, u + 0.2 * height, v], axis=-1)
    area = 0.5 * 0.4 * height**2
    usable = height >= 12
    profile = fit_height_profile([Blobs(None, boxes, boxes, area, usable)])
    if usable[20:].sum() < 30:
        return
    assert profile is not None
    expected = slope * v + lean * u + base
    error = np.abs(profile(u, v) - expected)[20:] / expected[20:]
    assert np.median(error) < 0.05


def test_no_profile_without_people():
    assert fit_height_profile([]) is None


def body(canvas, u, v, height):
    """Draw a person of plain zones: head, trunk, two legs."""
    legs = [(-0.11, -0.02, 0.5, 1), (0.02, 0.11, 0.5, 1)]
    for left, right, top, bottom in [(-0.06, 0.06, 0, 0.16), (-0.15, 0.15, 0.16, 0.52), *legs]:
        rows = slice(round(v - (1 - top) * height), round(v - (1 - bottom) * height))
        canvas[rows, round(u + left * height) : round(u + right * height)] = 1


@pytest.mark.parametrize(
    "people",
    [
        [(100, 150)],
        [(100, 150), (120, 152)],
        [(100, 150), (112, 170)],
        [(80, 140), (100, 150), (119, 146)],
    ],
)
def test_merged_bodies_are_told_apart(people):
    profile = HeightProfile(np.array([0.3, 0.0, 25.0]))
    canvas = np.zeros((240, 320), np.uint8)
    for u, v in people:
        body(canvas, u, v, profile(u, v))
    blobs = Blobs.find(canvas)
    assert len(blobs.box) == 1
    found = split_blob(canvas, blobs.box[0], profile)
    feet = np.array(sorted((person.u, person.v) for person in found))
    assert len(feet) == len(people)
    np.testing.assert_allclose(feet, sorted(people), atol=6)


def test_a_person_behind_a_wall_is_split_off_without_legs():
    """The template's feet lie where the height says, below the visible part."""
    profile = HeightProfile(np.array([0.3, 0.0, 25.0]))
    canvas = np.zeros((240, 320), np.uint8)
    body(canvas, 100, 150, 70)
    canvas[125:] = 0
    box = Blobs.find(canvas).box[0]
    (person,) = split_blob(canvas, box, profile)
    assert abs(person.u - 100) <= 4
    assert abs(person.v - 150) <= 8


def test_two_people_as_wide_as_one_are_two():
    """One behind the other: the silhouette has one person's height and width, but not the shape."""
    profile = HeightProfile(np.array([0.3, 0.0, 25.0]))
    canvas = np.zeros((240, 320), np.uint8)
    body(canvas, 100, 150, 70)
    body(canvas, 115, 147, 69)
    blobs = Blobs.find(canvas)
    x1, _, x2, _ = blobs.box[0]
    assert x2 - x1 < 0.7 * 70
    assert len(split_blob(canvas, blobs.box[0], profile)) == 2


def test_somebody_almost_hidden_is_found_where_expected():
    """Behind two others, a third person explains too little, except where expected."""
    profile = HeightProfile(np.array([0.3, 0.0, 25.0]))
    canvas = np.zeros((240, 320), np.uint8)
    people = [(92, 158), (112, 158), (102, 141)]
    for u, v in people:
        body(canvas, u, v, profile(u, v))
    box = Blobs.find(canvas).box[0]
    hints = [Expected(u + 3.0, v - 2.0, float(profile(u, v))) for u, v in people]
    found = split_blob(canvas, box, profile, hints)
    feet = np.array(sorted((person.u, person.v) for person in found))
    assert len(feet) == 3
    np.testing.assert_allclose(feet, sorted(people), atol=5)


def test_a_person_cut_in_two_by_a_pole_is_one_group():
    canvas = np.zeros((240, 320), np.uint8)
    body(canvas, 100, 150, 70)
    body(canvas, 200, 150, 70)
    canvas[:, 98:103] = 0
    blobs = Blobs.find(canvas)
    assert len(blobs.box) == 3
    alone = group_blobs(blobs.labels, 3, [])
    assert [len(parts) for parts, _ in alone] == [1, 1, 1]
    here, there, nowhere = (
        Expected(u, v, 70.0) for u, v in ((100.0, 150.0), (200.0, 150.0), (30.0, 200.0))
    )
    groups = group_blobs(blobs.labels, 3, [here, there, nowhere])
    assert sorted((len(parts), tuple(people)) for parts, people in groups) == [
        (1, (there,)),
        (2, (here,)),
    ]


@given(shift=st.integers(-40, 60), down=st.integers(-20, 40))
def test_splitting_moves_with_the_blob(shift, down):
    profile = HeightProfile(np.array([0.0, 0.0, 70.0]))
    people = [(100, 130), (118, 134)]
    found = []
    for dx, dy in ((0, 0), (shift, down)):
        canvas = np.zeros((240, 320), np.uint8)
        for u, v in people:
            body(canvas, u + dx, v + dy, 70)
        box = Blobs.find(canvas).box[0]
        feet = [(p.u - dx, p.v - dy) for p in split_blob(canvas, box, profile)]
        found.append(np.array(sorted(feet)))
    np.testing.assert_allclose(found[0], found[1], atol=2)  # half pixels may be rounded up or down
