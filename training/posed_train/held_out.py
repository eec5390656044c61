"""What a net in training does on held-out photos."""

from dataclasses import dataclass

from .best import Standing, standing_of
from .data import Views
from .spread import deviations, figures, in_words
from .validate import Predictor, predict_views, solve_pose


@dataclass(frozen=True)
class HeldOut:
    spread: dict[str, float]
    """Of the poses in the frame in which the object stood still."""
    standing: Standing | None
    """Against the poses that the photos were registered with, if the net does not choose the keypoints' frame."""

    def as_row(self) -> dict[str, float]:
        """For the log."""
        names = {"agreeing": "agreeing", "median_degrees": "spread_degrees", "median_mm": "spread_mm"}
        row = {name: self.spread[key] for key, name in names.items() if key in self.spread}
        row["held_out_photos"] = self.spread["photos"]
        if self.standing is not None:
            row["held_out_deg5_cm5_percent"] = round(self.standing.deg5_cm5_percent, 2)
            row["held_out_keypoint_px"] = round(self.standing.keypoint_median_px, 3)
        return row

    def in_words(self) -> str:
        return in_words(self.spread)


def look(net: Predictor, views: Views) -> HeldOut | None:
    """None where no views are held out."""
    indices = views.held_out
    if not indices:
        return None
    predictions = predict_views(net, [views.all[index] for index in indices])
    poses = [solve_pose(views.registration.keypoints, prediction) for prediction in predictions]
    cameras = {}
    for number, component in enumerate(views.registration.components):
        cameras |= {index: (number, pose) for index, pose in zip(component.views, component.camera_from_component)}
    scenes, camera_from_scene = zip(*(cameras[index] for index in indices))
    spread = figures(deviations(scenes, camera_from_scene, poses, views.motions))
    chosen_by_net = views.heights is None
    return HeldOut(spread, None if chosen_by_net else standing_of(views, indices, predictions, poses))
