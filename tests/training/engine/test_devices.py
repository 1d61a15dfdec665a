"""Where a network is trained: what is not here or not known is named before anything is read or written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from solver_backend.cli.main import main
from solver_backend.exchange.errors import BackendMissing, JobInvalid
from tests.support.line_task import SETTINGS, LineTask
from tests.support.swaying_corpus import job
from training.engine.loop import check_device, dropout_state, run_training, set_dropout_state
from training.gmm.train import train_gmm
from training.train import train


@pytest.fixture
def without_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def test_missing_cuda_is_named_before_the_recordings_are_read(tmp_path: Path, without_cuda: None) -> None:
    asked = replace(SETTINGS, device="cuda")
    with pytest.raises(BackendMissing, match=r"no CUDA device.*--device cpu"):
        train("sposer", tmp_path / "no recordings", tmp_path / "out", settings=asked)
    with pytest.raises(BackendMissing, match="no CUDA device"):
        run_training(LineTask(), asked, tmp_path / "run")
    assert not any(tmp_path.iterdir())


def test_command_line_names_what_is_missing(tmp_path: Path, without_cuda: None, capsys) -> None:
    line = ["train model", "rvposer", "--data", str(tmp_path), "--out", str(tmp_path / "out"), "--device"]
    assert main([*line, "cuda"]) != 0
    assert "no CUDA device" in capsys.readouterr().err
    assert main([*line, "abacus"]) != 0
    assert "abacus" in capsys.readouterr().err


def test_unknown_devices_are_named() -> None:
    check_device("cpu")
    with pytest.raises(JobInvalid, match=r"'tpu'.*cpu, cuda"):
        check_device("tpu")


def test_the_mixture_knows_no_device(tmp_path: Path) -> None:
    asked = job(tmp_path, 1)
    with pytest.raises(JobInvalid, match="only be fitted on the CPU"):
        train_gmm(replace(asked, settings=replace(asked.settings, device="cuda")))


def test_dropout_goes_on_from_its_state() -> None:
    state = dropout_state("cpu")
    first = torch.rand(3)
    set_dropout_state("cpu", state)
    assert torch.equal(first, torch.rand(3))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_both_devices_train_alike(tmp_path: Path) -> None:
    class PlainTask(LineTask):
        def __init__(self) -> None:
            super().__init__()
            self.model[2] = torch.nn.Identity()

        def loss(self, batch: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
            x = batch.to(next(self.model.parameters()).device)
            return (self.model(x)[:, 0] - x[:, 0] + 2 * x[:, 1]).square().mean()

    trained = [run_training(PlainTask(), replace(SETTINGS, device=d), tmp_path / d) for d in ("cpu", "cuda")]
    for a, b in zip(*(model.parameters() for model in trained), strict=True):
        assert b.device.type == "cpu" and torch.allclose(a, b, atol=1e-5)
