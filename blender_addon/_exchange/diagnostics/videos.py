"""Diagnostics of what is made of videos and sensors."""

from __future__ import annotations

from .entry import DiagnosticEntry, note, warning

VIDEOS: dict[str, DiagnosticEntry] = {
    "detector_used": note(
        "Detector: {detector}; {moments} moments at {rate:g} a second that all {videos} videos show",
        "The detections of videos come from this detector.",
    ),
    "hand_without_wrist": warning(
        "No two views agree on the {joint} in any frame; that hand is not looked for",
        "A hand is looked for at the end of its forearm. The views are not in step, their calibration is wrong, or the "
        "wrist is hidden.",
        "Check the cameras: the console names views that disagree.",
    ),
    "hand_not_found": note(
        "The hand at the {joint} is found in no picture",
        "It is hidden or gloved, it holds something, or it is smaller than about 15 pixels.",
    ),
    "footage_late": note(
        "The footage is {size:+.0f} pictures late of the detections",
        "The videos were cut or converted after the detections were made: hands in them are where the detections have "
        "the wrists so many frames before. The hands and the footage are moved in time.",
    ),
    "camera_turns": note(
        "Camera {camera}: turns by up to {size:.1f}°; the detections are as if it had stayed as in the first picture",
        "The camera was panned or held by hand. The background beside the person shows by how much.",
        "Footage behind the body fits in the first picture alone.",
    ),
    "camera_turn_unknown": note(
        "Camera {camera}: too little background is seen to show whether it turns; it is taken to stand still",
        "The wall is plain, people fill the picture, or the camera turned too fast for its pictures.",
    ),
    "camera_moves": warning(
        "Camera {camera}: its background moves by {moved:.0f} pixels, and turns leave {left:.1f} of them",
        "The camera was carried or zoomed, or something large moves behind the person.",
        "Film from one place; otherwise the person's path over the floor is not known.",
    ),
    "videos_searched": note(
        "{count} pictures by {detector}",
        "Keypoints were detected in all videos of the take.",
    ),
    "person_seldom_found": warning(
        "{file}: nobody is found in {share:.0f} % of the pictures",
        "The person is out of sight, far away or dark in this video, or the detector does not suit such pictures.",
        "Watch the video with its keypoints, and leave the camera out if they are poor.",
    ),
    "picture_rate_assumed": warning(
        "Pictures are taken to be filmed at {rate:g} a second",
        "A folder of pictures does not state its rate.",
        "Give the rate with --fps if it is another.",
    ),
    "calibration_kept": note(
        "Calibration: {file}, {count} cameras",
        "The take has its own calibration, or one was made before.",
    ),
    "cameras_calibrated": note(
        "{count} cameras by the {method}, {size:.1f} px",
        "The cameras were calibrated by the filmed board, or by the person.",
    ),
    "lens_footage_unused": note(
        "The footage for lenses is not used, as its board is not named",
        "The cameras are calibrated by the person, and neither --board nor a board.toml names the board.",
    ),
    "focal_length_of_video": note(
        "{camera}: the focal length is {size:.0f} px ± {share:.0f} %, by {source}",
        "A single camera without a calibration has its focal length from the user, its video's file, or a guess.",
    ),
    "focal_length_inexact": warning(
        "{camera}: the focal length is {size:.0f} px ± {share:.0f} %, by {source}; distances may be off by as much",
        "A single camera without a calibration has its focal length from its video's file, or a guess.",
        "Give the lens with --lenses or --focal.",
    ),
    "capture_written": note("Capture: {file}", "The capture was assembled, or is unchanged."),
    "cameras_fit_take": note(
        "The cameras fit the person to {size:.1f} px, {best:.1f} px at best",
        "Keypoints are compared with where the other cameras have them, before and after the poses are adjusted.",
    ),
    "one_camera_unconfirmed": note(
        "One camera: nothing confirms its calibration",
        "A calibration is checked by what several cameras see of one point.",
    ),
    "calibration_unchecked": note(
        "The take is too short to check the calibration",
        "No two cameras see the person at once for long enough.",
    ),
    "hands_found": note(
        "Two views show the left hand in {left:.0f} % of the frames, the right one in {right:.0f} %",
        "Hands were looked for where the body has its wrists.",
    ),
    "hands_found_one_view": note(
        "The view shows the left hand in {left:.0f} % of the frames, the right one in {right:.0f} %",
        "Hands were looked for where the body has its wrists.",
    ),
    "motion_written": note("Motion: {file}", "The capture was solved, or the motion is unchanged."),
    "clocks_as_filmed": note(
        "The cameras are taken as filmed: their clocks are not compared",
        "The user states that the cameras were started together, or nothing shows how their clocks differ.",
    ),
    "noise_map_applied": note(
        "Confidences stand for variances as measured of {measured} on {keypoints} keypoints",
        "A noise map was given.",
    ),
    "noise_map_of_another": note(
        "Confidences stand for variances as measured of {measured} on {keypoints} keypoints",
        "A noise map was given that was measured of another detector.",
        "These detections are of {detector}.",
    ),
    "clock_in_sync": note(
        "Clock of {camera}: in sync, by {method}",
        "The camera's clock differs from the first camera's by no more than the uncertainty of the estimate.",
    ),
    "clock_estimated": note(
        "Clock of {camera}: {offset_ms:+.2f} ms (± {offset_sigma_ms:.2f}), {rate_ppm:+.1f} ppm "
        "(± {rate_sigma_ppm:.1f}), by {method}",
        "The cameras were started by hand, or their clocks run at different rates. The detections are moved in time.",
    ),
    "clocks_assumed": warning(
        "The clocks are taken to agree: {reason}",
        "Neither the person's movement nor the sound shows when the recordings started.",
        "Let the person clap in sight of all cameras, or choose another method with --sync.",
    ),
    "wand_clocks_assumed": note(
        "The clocks are taken to agree at first: {reason}",
        "The wand's speed does not show how the clocks differ. The calibration still estimates small delays.",
        "Wave the wand so that all sensors see it speed up and slow down.",
    ),
    "rolling_shutter": warning(
        "Rolling shutter is not modelled: rows of a picture may differ by up to a frame",
        "Cameras that are not in step with each other also read their rows at different times.",
        "Use cameras with a common trigger where fast movement must be exact.",
    ),
    "clocks_disagree": warning(
        "{camera} and {other_camera} do not agree by {method}; the other cameras decide",
        "The lag between these two contradicts what all other pairs measure, and is left out.",
        "Check the picture of the clocks.",
    ),
    "clocks_contradict": warning(
        "The lags of the cameras by {method} contradict each other by {off_ms:.0f} ms",
        "Pairs of cameras measure lags that no set of clocks explains, and too few pairs are left to leave one out.",
        "Try another method with --sync, or give the offsets.",
    ),
    "claps_ambiguous": warning(
        "The claps that {camera} saw fit {off_ms:+.0f} ms from there nearly as well",
        "Claps at even intervals look alike when one is skipped.",
        "Clap three times at uneven intervals, with both hands in sight of all cameras.",
    ),
    "common_time_short": warning(
        "All videos together show {span:.1f} s of the longest video's {longest:.1f} s",
        "A camera was started late or stopped early, or the estimated offset is wrong.",
        "Leave out the camera that was started or stopped at another time, or check the clocks.",
    ),
    "video_rates_mixed": note(
        "The videos run at {rates} pictures a second; all are read at {rate:g}",
        "The cameras record at different rates. Detections between pictures are interpolated.",
    ),
    "intervals_uneven": note(
        "{file} has uneven intervals, up to {gap_ms:.0f} ms; read by its times",
        "Telephones record at a varying rate, and cameras drop pictures.",
    ),
    "picture_cut": note(
        "{camera}: made at {made}, filmed at {filmed} px; taken to be cut, not scaled",
        "The calibration's pictures are a little larger or smaller: a coder cuts them to whole blocks.",
    ),
    "calibration_scaled": note(
        "{camera}: made at {made}, filmed at {filmed} px; the calibration was scaled",
        "The camera was calibrated at another resolution than it filmed in.",
    ),
    "person_seen_most": note(
        "The person is whoever is seen most in each view: no calibration yet",
        "Without calibrated cameras the views cannot be compared.",
    ),
    "cameras_not_calibrated": warning(
        "The cameras are not calibrated",
        "Detections were made without a calibration.",
        "Calibrate them before you solve.",
    ),
    "detected_live": note(
        "Detected live by {source}; the poses of then are in {file}",
        "The capture was recorded while it was solved live.",
    ),
    "sensor_missing": warning(
        "Sensor {camera} is in the calibration but not in the folder",
        "The sensor was not recorded, or its folder has another name.",
        "Check the folder if the sensor should be there.",
    ),
    "sensor_ended": warning(
        "Sensor {camera} ended: {reason}",
        "The sensor was unplugged, or its recording is damaged. The others go on.",
        "Check its cable and its files.",
    ),
    "sensor_trouble": warning(
        "Sensor {camera}: {reason}",
        "The sensor or its recording failed. The others go on.",
        "Check its cable and the disk.",
    ),
    "sensor_gap": warning(
        "Sensor {camera}: nothing came from it for {gap:.2f} s{when}",
        "The sensor, its cable or the computer paused.",
        "Check its cable, and what else the computer does.",
    ),
    "sensor_silent": warning(
        "Sensor {camera}: nothing comes from it; the others go on{when}",
        "The sensor was unplugged or its process hangs.",
        "Check its cable.",
    ),
    "sensor_back": warning(
        "Sensor {camera}: it is back{when}",
        "The sensor was silent and sends frames again.",
        "Until then the points are of the other sensors alone.",
    ),
    "sensor_clock_jumped": warning(
        "Sensor {camera}: its clock jumped by {step:.3f} s; the computer's clock is used{when}",
        "The sensor's clock was set, or it restarted.",
        "Times around the jump are less exact.",
    ),
    "sensor_time_missing": warning(
        "Sensor {camera}: a frame without a time is left out{when}",
        "The recording's index is damaged, or the sensor sent a time that is not a number.",
        "Look at the index of the recording.",
    ),
    "sensor_sunlight": warning(
        "Sensor {camera}: too much of the picture is bright{when}",
        "Sunlight, a window or a lamp shines at the sensor. Its markers are not found there.",
        "Remove the light, or record the empty scene for a mask.",
    ),
    "synthetic": note(
        "Synthetic capture: {origin}; the truth is known",
        "The capture was computed, not recorded.",
    ),
    "perturbed": note(
        "Perturbed: {faults}",
        "Errors were added to a synthetic capture on purpose.",
    ),
}
"""By code."""
