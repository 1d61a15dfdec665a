"""Model cards: what a prior was trained on, how, and how well it does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_SOURCES = """## Data and licence

- **CMU motion capture** (mocap.cs.cmu.edu), {train_clips} clips, {train_frames} frames at 30 Hz, of which
  {train_distinct} are distinct (no two closer than {near_repeat_mm:.0f} mm, root mean square over the joints).
  "The data used in this project was obtained from mocap.cs.cmu.edu. The database was created with funding from NSF
  EIA-0196217." Free to copy, modify and redistribute; not for direct resale.
- **Hand-keyed animations** by Quaternius and Mesh2Motion (CC0): {keyed_clips} of these clips (rolling, sitting,
  kneeling, crouching, swimming, falling), each distinct pose counted {keyed_repeats} times.
- **Validation**: subjects {held_out}, {validation_clips} clips, {validation_frames} frames, {validation_distinct}
  distinct; nothing is trained on them. Conversions that do not keep the subject's number are trained on unless their
  frames repeat validation frames, so other takes of a validation subject may be among them.

How recordings became poses of the 21 body joints: each bone's rotation since the T-pose carries over whole; half of the
hand's twist is given to the elbow. The CMU recordings' collar bones do not move and their hands hardly bend: collars
follow the arms by a fixed rhythm (22 % of the elevation, 15 % of the forward swing).
"""
_AUGMENTATION = """
Augmentation: mirrored left to right; arms, legs, head and spine exchanged between clips (kept when no arm joint comes
within 7 cm of a trunk, head or leg bone); collars varied by 5°, wrists by 12°, spine, neck and head by 3°, the other
joints by 1.5°.
"""
_METHOD = """Measured with the weights as they ship, all distinct validation poses, 24 joints, pelvis fixed, on a
skeleton of 1.70 m. `between_keys`: frames from SIDER2 of three keys' codes.
"""
_LIKELIHOOD = """Mean log densities of the rotation vectors of all distinct poses.
"""


def write_model_card(
    path: Path, title: str, summary: str, metadata: dict[str, Any], *, augmented: bool = True, method: str = ""
) -> None:
    """Write the card beside the weights.

    Args:
        path: the card.
        title: name of the prior.
        summary: a few sentences on what it is.
        metadata: ``data, command, settings, metrics, sha256``.
        augmented: whether training drew augmented poses.
        method: how the metrics were measured, where that is not how the other priors' are.
    """
    method = method or (_METHOD if "mpjpe_mm" in metadata["metrics"] else _LIKELIHOOD)
    augmentation = _AUGMENTATION if augmented else ""
    metrics = "\n".join(f"| `{key}` | {value:.4g} |" for key, value in metadata["metrics"].items())
    settings = "\n".join(f"| `{key}` | {value} |" for key, value in metadata["settings"].items())
    text = (
        f"# {title}\n\n{summary}\n\n{_SOURCES.format(**metadata['data'])}{augmentation}\n"
        f"## Training\n\n`{metadata['command']}`\n\n| setting | value |\n|---|---|\n{settings}\n\n"
        f"## Validation\n\n{method}\n"
        f"| metric | value |\n|---|---|\n{metrics}\n\n"
        f"Arrays' SHA-256: `{metadata['sha256']}`\n"
    )
    path.write_text(text, encoding="utf-8")
