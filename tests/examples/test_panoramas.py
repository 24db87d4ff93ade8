import re
import sys

import numpy as np
import pytest

from catfree.adapters import RaySource


def test_panoramas_are_ray_sources(load_example):
    panorama = load_example("panoramas").panorama
    assert isinstance(panorama, RaySource)
    middle = np.array([[1919.5, 959.5]])
    np.testing.assert_allclose(panorama(0, middle), [[0, 0, 1]], atol=1e-12)


@pytest.mark.slow
def test_both_methods_locate_people_in_panoramas(load_example, monkeypatch, capsys):
    arguments = ["panoramas.py", "--frames", "30"]
    monkeypatch.setattr(sys, "argv", arguments)
    load_example("panoramas").main()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["evidence", "paper"]
    (evidence, people, error), (paper, _, by_paper) = (
        map(float, re.findall(r"[0-9.]+", line)) for line in lines
    )
    assert people >= evidence > paper > 0
    assert error <= by_paper
