"""The verbs by task, each with an example: ``--help`` and docs/reference/command-line.md are made from it."""

from __future__ import annotations

import argparse

TASKS: dict[str, dict[str, str]] = {
    "Look at a capture": {
        "info": "info trial",
        "people": "people trial",
        "convert": "convert trial --out trial.npz",
        "demo-capture": "demo-capture --out demo.npz",
    },
    "Solve": {
        "solve": "solve trial --out motion.npz --report report.html",
        "from-videos": "from-videos footage --dry-run",
        "evaluate": "evaluate demo.npz motion.npz",
        "bodies": "bodies",
    },
    "Videos": {
        "detect": "detect cam01.mp4 cam02.mp4 --out capture.npz",
        "detector-noise": "detector-noise capture.npz --out noise.json",
        "find-hands": "find-hands trial --model hand_landmark_full.tflite --python litert/bin/python --out hands.npz",
    },
    "Markers": {
        "label": "label take.c3d --out labelled.c3d",
        "calibrate": "calibrate range_of_motion.c3d --out subject.npz",
        "layout": "layout take.c3d --out layout.json",
        "marker-places": "marker-places --out places.png",
        "export-markers": "export-markers motion.npz --out cleaned.c3d",
        "export-props": "export-props motion.npz --out props.json",
    },
    "Cameras": {
        "check-cameras": "check-cameras trial",
        "fit-cameras": "fit-cameras trial --stature 1.78 --out calibration.toml",
        "refine-cameras": "refine-cameras trial --out refined.npz",
        "calibrate-cameras": "calibrate-cameras boards --from board --board charuco:8x11:24mm --out calibration.toml",
        "board": "board charuco:5x7:35mm --out board.pdf",
    },
    "Sensors": {
        "oaks": "oaks",
        "record-oak": "record-oak take --oak ID1=front --oak ID2=left --sync wire --seconds 30",
        "record-colour": "record-colour take --oak ID1=front --oak ID2=left --seconds 20",
        "calibrate-wand": "calibrate-wand wand --out rig.toml",
        "markers-from-sensors": "markers-from-sensors take --out cloud.c3d",
        "rig-record": "rig-record take --out copy",
        "rig-live": "rig-live take --poses",
    },
    "Live": {
        "live": "live take.c3d --lines poses.jsonl --send vmc://",
        "camera-live": "camera-live cam01=webcam:0 cam02=webcam:1 --calibration calibration.toml --record take.npz",
    },
    "Clean up and make motions": {
        "motion": "motion clip.bvh --out motion.npz",
        "denoise": "denoise motion.npz smooth.npz",
        "complete": "complete motion.npz whole.npz --missing left_arm",
        "interpolate": "interpolate motion.npz filled.npz --frames 10 40 --count 30",
        "sample": "sample poses.npz --count 100",
    },
    "Make data sets": {
        "studio": "studio spec.json --out set",
        "studio-judge": "studio-judge set",
        "studio-rigs": "studio-rigs spec.json --out rigs.html",
    },
    "Train": {
        "train": "train sposer --data data --out trained",
    },
}
"""Task, then verb, then what somebody would type."""

EXAMPLES = {verb: example for verbs in TASKS.values() for verb, example in verbs.items()}


def list_verbs(help_of: dict[str, str]) -> str:
    """Return the verbs by task, one a line with its help; verbs without a row come last.

    Args:
        help_of: one line of help by verb, as the parser has it.
    """
    width = max(map(len, help_of)) + 2
    others = {verb: "" for verb in help_of if verb not in EXAMPLES}
    tasks = TASKS | ({"Other": others} if others else {})
    blocks = []
    for task, verbs in tasks.items():
        rows = [f"  {verb:{width}}{help_of[verb]}" for verb in verbs if verb in help_of]
        blocks.append("\n".join([f"{task}:", *rows]))
    return "\n\n".join(blocks)


def show_guide(parser: argparse.ArgumentParser, verbs: argparse._SubParsersAction) -> None:
    """Group the verbs of a parser's help by task, and give each verb's own help its example."""
    help_of = {action.dest: action.help or "" for action in verbs._choices_actions}
    verbs._choices_actions.clear()  # argparse lists them in the order of adding alone
    verbs.metavar, verbs.help = "VERB", "what to do; VERB --help lists its options"
    parser.epilog = f"{list_verbs(help_of)}\n\n{parser.epilog or ''}"
    for verb, own in verbs.choices.items():
        own.description = f"{help_of.get(verb, '')[:1].upper()}{help_of.get(verb, '')[1:]}."
        if verb in EXAMPLES:
            own.epilog = f"example:\n  {parser.prog} {EXAMPLES[verb]}"
        own.formatter_class = argparse.RawDescriptionHelpFormatter
