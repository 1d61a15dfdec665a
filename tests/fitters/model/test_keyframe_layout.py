"""The windows of a layout and their frames."""

import numpy as np
import pytest

from solver_backend.fitters.model.keyframe_layout import KeyframeLayout


@pytest.mark.parametrize(("num_frames", "window"), [(4, 20), (27, 9), (100, 20), (101, 7), (21, 20)])
def test_layout_covers_every_frame_once(num_frames, window):
    layout = KeyframeLayout.even(num_frames, window)
    index, time = layout.positions(layout.frames)
    np.testing.assert_array_equal(layout.frames, np.arange(num_frames))
    assert time.min() >= 0 and time.max() <= 1
    np.testing.assert_allclose(layout.bounds[index] + time * np.diff(layout.bounds)[index], layout.frames, atol=1e-9)
    rows = layout.rows()
    np.testing.assert_array_equal(np.sort(rows.frames[rows.weight > 0]), np.arange(num_frames))
    for w in range(layout.num_windows):
        inside = rows.weight[w] > 0
        np.testing.assert_array_equal(index[rows.frames[w, inside]], w)
        np.testing.assert_allclose(rows.time[w, inside], time[rows.frames[w, inside]])


@pytest.mark.parametrize("stride", [2, 3, 7])
def test_rows_with_a_stride_stand_for_the_frames_left_out(stride):
    rows = KeyframeLayout.even(101, 20).rows(stride)
    assert 101 - 5 * stride <= rows.weight.sum() <= 101 + 5 * stride
    assert (np.diff(rows.frames, axis=1)[rows.weight[:, 1:] > 0] == stride).all()
