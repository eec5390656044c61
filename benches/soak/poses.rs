//! What the answers to an image must say: what the server says when nobody else is there.

use posed::proto::EstimateResponse;
use serde_json::Value;

/// Objects with their places, metres.
pub struct Poses(Vec<(String, [f64; 3])>);

/// Images that are worked on together may differ in the last digits.
const TOLERANCE_M: f64 = 1e-3;

impl Poses {
    pub fn of_json(answer: &Value) -> Self {
        let poses = answer["poses"].as_array().map_or(&[][..], Vec::as_slice);
        let place = |pose: &Value| {
            let place = serde_json::from_value(pose["camera_from_object"]["translation_m"].clone()).ok()?;
            Some((pose["object"].as_str()?.to_owned(), place))
        };
        Self(poses.iter().filter_map(place).collect())
    }

    pub fn of_response(answer: &EstimateResponse) -> Self {
        let place = |pose: &posed::proto::ObjectPose| {
            let t = pose.solved.as_ref()?.camera_from_object?;
            Some((pose.object.clone(), [t.translation_x_m, t.translation_y_m, t.translation_z_m]))
        };
        Self(answer.poses.iter().filter_map(place).collect())
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether both have the same objects at the same places.
    pub fn agree(&self, other: &Self) -> bool {
        let has = |one: &(String, [f64; 3])| other.0.iter().any(|two| one.0 == two.0 && near(one.1, two.1));
        self.0.len() == other.0.len() && self.0.iter().all(has)
    }
}

fn near(one: [f64; 3], two: [f64; 3]) -> bool {
    one.iter().zip(two).all(|(one, two)| (one - two).abs() < TOLERANCE_M)
}
