"""Solve the segments of a long take on a Dask cluster (Rocklin 2015), which is optional.

Dask pickles everything that it sends, so a scheduler must be as trustworthy as this machine.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

from solver_backend.exchange.cluster_address import require_certificates, require_safe
from solver_backend.exchange.errors import BackendMissing, Cancelled, CommandLineInvalid
from solver_backend.exchange.version import VERSION
from solver_backend.fitters.keyframes.normal_equations import BundleModel
from solver_backend.fitters.keyframes.optimise import KeySolution, Stretch, in_turn
from solver_backend.fitters.model.subject import Subject
from solver_backend.priors.base import PosePrior

logger = logging.getLogger("solver_backend")
_CONNECT_S, _POLL_S = 10.0, 0.05
_RETRIES = 2
"""Maximum number of further attempts at a segment whose worker died. Chosen by hand."""


class VersionsDiffer(Exception):
    """A cluster worker runs a different version of the program."""


class ClusterStretches:
    """Solves the segments of a long take on a cluster, or in this process if the cluster fails.

    Args:
        address: address of the scheduler, or the name of a file that contains it.

    Raises:
        SchedulerUnsafe: the scheduler is on another host without TLS, or certificates are missing.
    """

    def __init__(self, address: str) -> None:
        require_safe(address)
        try:
            import dask.config
            from distributed import Client
        except ImportError as error:
            hint = "Install it with: pip install distributed. Or omit --scheduler."
            raise BackendMissing("Dask is not installed in this Python.", hint=hint) from error
        require_certificates(address, dask.config.get("distributed.comm.tls.ca-file", None))
        where: dict[str, Any] = {"scheduler_file" if address.endswith(".json") else "address": address}
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            self._client = Client(**where, timeout=_CONNECT_S, set_as_default=False)
        except Exception as error:  # network, protocol or message errors caused by another version
            message = f"No scheduler responds: {type(error).__name__}: {error}."
            hint = "Start one with 'dask scheduler', or omit --scheduler."
            raise CommandLineInvalid(message, where=address, hint=hint) from error
        self.solved_there = 0
        """Number of segments that workers have solved."""

    def __call__(self, stretches: Sequence[Stretch], alive: Callable[[], None]) -> list[KeySolution]:
        """Solve the segments of a take. A single segment is solved in this process."""
        if len(stretches) < 2:
            return in_turn(stretches, alive)
        model = stretches[0].model
        common = self._sent_ahead((model.subject, model.prior))
        futures = [self._submitted(stretch, common) for stretch in stretches]
        try:
            return [self._result(future, stretch, alive) for future, stretch in zip(futures, stretches, strict=True)]
        finally:
            for future in filter(None, futures):
                future.release()

    def close(self) -> None:
        """Disconnect from the cluster."""
        self._client.close(timeout=2)

    def _sent_ahead(self, common: tuple[Subject, PosePrior]) -> Any:
        """Send the person and the prior, which all segments share, to the workers in advance."""
        try:
            return self._client.scatter(common, broadcast=True, hash=False)
        except Exception:
            logger.exception("The person could not be sent to the workers in advance.")
            return common

    def _submitted(self, stretch: Stretch, common: Any) -> Any:
        alone = stretch.alone()
        model = alone.model
        rest = (model.objective, model.free, alone.layout, alone.keys, alone.schedule, alone.fixed)
        try:
            return self._client.submit(_solve, common, rest, VERSION, pure=False, retries=_RETRIES)
        except Exception:
            logger.exception("A segment could not be sent. It is solved here.")
            return None

    def _result(self, future: Any, stretch: Stretch, alive: Callable[[], None]) -> KeySolution:
        if future is not None:
            while future.status == "pending" and self._client.status == "running":
                alive()
                time.sleep(_POLL_S)
            try:
                if future.status == "finished":
                    solved = future.result(timeout=_CONNECT_S)
                    self.solved_there += 1
                    return solved
                logger.warning("The cluster did not solve a segment (%s). It is solved here.", _why(future))
            except Cancelled:
                raise
            except Exception:
                logger.exception("The result of a segment did not arrive. It is solved here.")
        return stretch.solve(alive)


def _solve(common: tuple[Subject, PosePrior], rest: tuple[Any, ...], version: str) -> KeySolution:
    objective, free, layout, keys, schedule, fixed = rest
    if version != VERSION:
        raise VersionsDiffer(f"the worker has Manifold MoCap {VERSION}, the take is solved with {version}")
    return Stretch(BundleModel(*common, objective, free), layout, keys, schedule, fixed).solve()


def _why(future: Any) -> str:
    if future.status != "error":
        return str(future.status)
    error = future.exception(timeout=_CONNECT_S)
    return f"{type(error).__name__}: {error}"
