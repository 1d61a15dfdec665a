"""Verbs that clean up and make motions, make data sets and train."""

from __future__ import annotations

from dataclasses import replace

from .. import verb_results as results
from ..setting import POSITIVE, REQUIRED
from ..verb import Verb, flag, option, output, place, values
from .shared import BENCHMARK_SETTINGS, BODY, MOTION_IN_AND_OUT, OVERWRITE, PLACES, PRIOR, SEED, SPEC

_MOTIONS, _SETS, _TRAIN = "Clean up and make motions", "Make data sets", "Train"
_MOTION_OUT = output("MOTION.npz", "Motion file to write")

VERBS = (
    Verb(
        "motion", _MOTIONS, "motion", "convert a motion of another program to our body",
        "motion clip.bvh --out motion.npz", "motion_verbs:motion",
        (
            place("path", "clip", "CLIP", "Motion of any skeleton (BVH, MVNX, C3D segments, AMASS)"),
            _MOTION_OUT,
            option("text", "unit", "UNIT", "Length unit of the clip; estimated from the legs if left out", ""),
            option("text", "up_axis", "AXIS", "Axis that points up in the clip; detected if left out", ""),
            flag("keep_height", "Keep the clip's height; do not put the soles on the floor"),
            BODY, OVERWRITE,
        ),
        results.ClipResult,
    ),
    Verb(
        "add-hands", _MOTIONS, "hands", "add the fingers of gloves, or of another program, to a motion",
        "add-hands motion.npz gloves.bvh --out hands.npz", "glove_verbs:add_hands",
        (
            place("path", "motion", "MOTION.npz", "Motion to which the hands are added; AMASS too"),
            place("path", "gloves", "GLOVES", "Recordings of hands: BVH, or CSV of MANUS or Rokoko; one file, or one "
                  "for each hand", many=True),
            _MOTION_OUT,
            option("number", "offset", "SECONDS", "Second of the motion at which the gloves begin; estimated from "
                   "wrist rotation if left out"),
            option("choice", "side", "", "Side of a file with one hand, where its names do not show it", "",
                   choices=values("left", "right")),
            BODY, OVERWRITE,
        ),
        results.GlovesResult,
    ),
    Verb(
        "denoise", _MOTIONS, "motion", "denoise a motion with Pose-NDF", "denoise motion.npz smooth.npz",
        "pose_verbs:denoise",
        (
            *MOTION_IN_AND_OUT,
            option("number", "smoothness", "λ", "Weight of smoothness against the data's 1", low=0),
            option("number", "manifold", "λ", "Weight of plausibility against the data's 1", low=0),
            flag("keep_root", "Keep the body's place and heading as they are"),
            PRIOR, OVERWRITE,
        ),
    ),
    Verb(
        "complete", _MOTIONS, "motion", "fill in unknown joint rotations with Pose-NDF",
        "complete motion.npz whole.npz --missing left_arm", "pose_verbs:complete",
        (
            *MOTION_IN_AND_OUT,
            option("text", "missing", "JOINT", "Joints, or limbs such as left_arm, right_leg", REQUIRED, many=True),
            SEED, PRIOR, OVERWRITE,
        ),
    ),
    Verb(
        "interpolate", _MOTIONS, "motion", "generate the transition between two frames with Pose-NDF",
        "interpolate motion.npz filled.npz --frames 10 40 --count 30", "pose_verbs:interpolate",
        (
            *MOTION_IN_AND_OUT,
            option("whole", "frames", "A B", "The two frames, counted from 0", REQUIRED, count=2),
            option("whole", "count", "N", "Number of frames to make between them", REQUIRED),
            PRIOR, OVERWRITE,
        ),
    ),
    Verb(
        "fit-keypoints", _MOTIONS, "motion", "refit a motion to a capture's keypoints with Pose-NDF",
        "fit-keypoints trial motion.npz fitted.npz", "pose_verbs:fit_keypoints",
        (
            place("path", "capture", "CAPTURE", "Calibrated views of one person, one or several"),
            *MOTION_IN_AND_OUT,
            option("number", "noise_px", "PX", "Standard deviation of a detection in pixels", 5.0, low=POSITIVE),
            option("number", "manifold", "λ", "Weight of plausibility", 100.0, low=0),
            flag("constant", "Keep the weight constant, not growing with the distance (eq. 11)"),
            PRIOR, OVERWRITE,
        ),
    ),
    Verb(
        "sample", _MOTIONS, "motion", "draw random plausible poses with Pose-NDF", "sample poses.npz --count 100",
        "pose_verbs:sample",
        (MOTION_IN_AND_OUT[1], option("whole", "count", "N", "Number of poses", 20), SEED, PRIOR, OVERWRITE),
    ),
    Verb(
        "studio", _SETS, "dataset", "render synthetic captures with ground truth", "studio spec.json --out set",
        "studio_verbs:studio",
        (
            SPEC,
            output("DIR", "Folder of the data set; an interrupted run resumes", kind="folder", is_output=False),
            flag("plan", "Check the description and report what would be made", excludes="begin"),
            flag("claim", "Do the same, and reserve the folder for --shot", excludes="begin"),
            option("text", "shot", "NAME", "Make only these shots, in a folder reserved with --claim; several "
                   "processes may share it", (), many=True),
        ),
        results.DataSetPlan,
    ),
    Verb(
        "studio-benchmark", _SETS, "dataset", "solve a data set and compare with its ground truth",
        "studio-benchmark set", "studio_verbs:studio_benchmark",
        (
            place("folder", "data_set", "DIR", "Folder of the data set"),
            option("text", "methods", "METHOD", "Methods of solve, or triangulation", ("global",), many=True),
            option("choice", "inputs", "", "Kinds of capture to solve", (), choices=values("views", "markers"),
                   many=True),
            option("choice", "faults", "", "With errors added, or without", ("perturbed",),
                   choices=values("clean", "perturbed"), many=True),
            PLACES, BENCHMARK_SETTINGS,
        ),
        results.BenchmarkResult,
    ),
    Verb(
        "studio-cameras", _SETS, "dataset", "map the expected error of camera layouts over the floor",
        "studio-cameras spec.json --out cameras.html", "studio_verbs:studio_cameras",
        (
            replace(SPEC, description="Description; only its camera arrays and perturb are used"),
            option("text", "faults", "PRESET", "Presets of faults to compare, instead of the description's", (),
                   many=True),
            output("PAGE.html", "Page to write"),
            OVERWRITE,
        ),
    ),
    Verb(
        "train", _TRAIN, "train", "train a pose prior or network, or resume from a checkpoint",
        "train sposer --data data --out trained", "verbs:train",
        (
            place("text", "prior", "PRIOR", "What to train: sposer, rvposer, vposer, svae, lie_vae, gmm, ..., "
                  "landmarks"),
            option("text", "row", "ROW", "Landmark network: ours, base, ortho, bmse, democap or others", "ours"),
            option("whole", "width", "N", "Width of the landmark network's layers; its own if left out", 0),
            option("whole", "resolution", "N", "Pixels of the maps that published rows draw; 160 if left out", 0),
            option("choice", "balanced_by", "", "Prior that finds a landmark network's rare poses, where DIR is a "
                   "folder of recordings", "rvposer", choices=values("rvposer", "vposer")),
            option("number", "seconds", "S", "How long to train a landmark network, instead of --steps"),
            flag("processor", "Count CPU time, not wall-clock time, for --seconds"),
            option("folder", "data", "DIR", "Folder that holds motion_cmu", REQUIRED),
            output("DIR", "Folder for the weights and the model card", "trained", "folder", is_output=False),
            option("folder", "work", "DIR", "Folder for checkpoint and log; OUT/PRIOR_run if left out"),
            SEED,
            option("whole", "steps", "N", "Gradient steps in all"),
            option("whole", "batch", "N", "Windows in a step"),
            option("number", "learning_rate", "X", "Largest learning rate"),
            option("choice", "device", "", "Where the network is trained", "cpu", choices=values("cpu", "cuda")),
            option("whole", "workers", "N", "Processes that draw batches ahead of the network"),
            option("whole", "hidden", "N", "Width of SPoser's decoder layers", 512),
            option("path", "start", "WEIGHTS", "Weights to start from (sposer, lifter), or a checkpoint (landmarks)",
                   option="--from"),
            option("choice", "part", "", "Train this part of SPoser alone, for --from's decoder",
                   choices=values("encoder")),
        ),
    ),
    Verb(
        "export-network", _TRAIN, "train", "write a landmark network as ONNX, from points to positions in metres",
        "export-network trained/landmarks_base_run --out base.onnx", "network_verbs:export_network",
        (
            place("folder", "trained", "FOLDER", "A trained row of the landmark networks (--work of train landmarks); "
                  "the network that ships if left out", None),
            output("NETWORK.onnx", "File to write"),
            OVERWRITE,
        ),
    ),
)  # fmt: skip
"""In the order in which help lists them."""
