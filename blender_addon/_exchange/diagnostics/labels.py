"""Diagnostics of labels: which markers a solve knows, which it leaves out, and what the labelling network named."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

_READ: dict[str, DiagnosticEntry] = {
    "few_markers_known": warning(
        "Only {count} markers are known, {markers}; a solve needs {least}",
        "Labels name no places on a body, or the file holds a part of the recording.",
        "Name the points with `label`, or write the labels' places with `layout` and solve with `--layout`.",
    ),
    "labels_left_to_network": note(
        "The labels name too few places on a body ({count} of {total}), so the labelling network names the markers. "
        "It knows whole bodies, and the solve refuses a layout that it does not know",
        "Labels such as numbers name no place on a body.",
        "Write the labels' places with `layout` and solve with `--layout`, or name a take after a labelled one with "
        "`label --like`.",
    ),
    "labels_doubled": warning(
        "Labels are there more than once: {markers}; the later ones are numbered",
        "A marker was named twice, or two people have labels without prefixes.",
        "Correct the labels in the program that recorded them.",
    ),
    "points_without_label": warning(
        "{count} of {total} points have no label",
        "Some points were not named before the export.",
        "Name them in the program that recorded them, or with `label`.",
    ),
    "no_point_named": note(
        "None of the {count} points is named: the solve names them", "The file was exported before anybody named it."
    ),
    "points_taken_for": note(
        "The {count} points are taken for {joint_set}: no file names them",
        "One joint set alone has so many points.",
        "Write their names into a text file beside the array if that is wrong.",
    ),
    "point_names_read": note("Names are read from {file}", "A file beside the array names its points."),
    "subject_chosen": note(
        "{person} is solved, the only subject with a body's markers; no part of it: {others}",
        "The file holds things beside a person.",
    ),
    "label_prefix_shared": note(
        "'{text}' begins nearly all labels and is read as no part of their names",
        "The labels carry a subject's or a trial's name.",
    ),
    "label_suffix_shared": note(
        "'{text}' ends nearly all labels and is read as no part of their names",
        "The labels carry the name of a step of processing.",
    ),
    "labels_ambiguous": note(
        "Labels that may name either of two places, which are not guessed: {choices}",
        "Programs use these labels for different places.",
        "Write what they mean with `layout`, and solve with `--layout`.",
    ),
    "labels_of_joint_centres": note(
        "The labels are joint centres of a skeleton: {count} of them are solved as such",
        "The file was written by a program that computed a skeleton.",
    ),
    "labels_of_hands": note(
        "Markers of hands: {left} on the left one, {right} on the right one",
        "Labels such as L_FT2 name places of a hand. The fingers are solved from them, beside the body.",
    ),
    "labels_of_no_layout": note(
        "Labels of no layout ({count}): {markers}",
        "Somebody named markers in words of their own.",
        "The solve finds the bone that each moves with, or leaves it out.",
    ),
    "differing_joints_left_out": note(
        "Left out of the solve: joints whose place differs between skeletons ({count}), {markers}",
        "Programs place these joints differently.",
    ),
    "computed_points_left_out": note(
        "Left out of the solve: points that a program computed ({count}), {markers}",
        "The file holds joint centres or other points that no camera saw.",
    ),
    "doubled_points_left_out": note(
        "Left out of the solve: points of places that another marker has ({count}), {markers}",
        "Two labels mean the same place.",
    ),
    "nameless_points_left_out": note(
        "Left out of the solve: points without names ({count}), {markers}",
        "Strays and reflections were recorded, or some markers were not named.",
    ),
}
"""What labels of a file mean."""

_NAMED: dict[str, DiagnosticEntry] = {
    "points_named": note(
        "A network named {named:.1f} % of the points, as {count} markers; "
        "{nobody:.1f} % are not on a person, {unknown:.1f} % stay unknown",
        "Takes without labels are labelled before they are solved; `label` names the points of any take.",
    ),
    "labels_named": note(
        "The labels name no places. A network named {named:.1f} % of the points, as {count} markers; "
        "{nobody:.1f} % are not on a person, {unknown:.1f} % stay unknown",
        "Labels such as numbers name no place on a body.",
    ),
    "points_named_after": note(
        "Named after {take}: {named:.1f} % of the points, as {count} markers",
        "The take was named after another of the same person and layout.",
    ),
    "points_named_of_person": note(
        "Points are named by where they ride on the person's bones ({count}): {markers}",
        "The person was calibrated with these markers.",
    ),
    "points_doubted_of_person": warning(
        "Points near markers of the person, though not clearly at one of them, stay without names ({count} tracks)",
        "Two of the person's markers are as near, another track is nearer, or the marker was moved.",
        "Name them with --labels, or calibrate the person from this take.",
    ),
    "layout_unknown_to_network": warning(
        "The labels name too few places, and the labelling network, which knows whole bodies, names only "
        "{percent:.0f} % of the markers: its names are not used",
        "The markers are in clusters, or on a part of a body.",
        "Write the labels' places with `layout`, and solve with `--layout`.",
    ),
    "more_points_than_a_person": warning(
        "{count:.0f} markers are seen at a time; the labelling network names those of one person, {most} at most, and "
        "is not used",
        "The recording holds several people or many strays, under labels that name no places.",
        "Label each person under a prefix of their own, or write the labels' places with `layout` and solve with "
        "`--layout`.",
    ),
    "points_not_named": warning(
        "{percent:.0f} % of the points could not be named surely; they are left out of the solve",
        "Strays, short stretches, or a layout that the network knows little of.",
        "Correct the labels in Blender or with --labels.",
    ),
    "points_not_named_after": warning(
        "{percent:.0f} % of the points could not be named surely",
        "The take is of another person or layout than the labelled one, or holds many strays.",
        "Look at the labelled file, or name it after another take.",
    ),
}
"""What labelling named."""

LABELS: dict[str, DiagnosticEntry] = {**_READ, **_NAMED}
