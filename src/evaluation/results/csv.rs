use std::path::Path;

use csv::{Reader, StringRecord, Writer};
use posed_core::geometry::{METRES_PER_MILLIMETRE, Pose};

use super::error::ResultsError;

const HEADER: [&str; 7] = ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"];
/// No estimate of any dataset of BOP is so near to its camera.
const METRES_BELOW_MM: f64 = 10.0;

/// One estimated pose: a line of `METHOD_DATASET-SPLIT.csv` (BOP challenge, "Formats of results").
#[derive(Clone, Debug, PartialEq)]
pub struct PoseResult {
    pub scene_id: u32,
    pub image_id: u32,
    pub obj_id: u32,
    /// Larger is better; any scale.
    pub score: f64,
    pub camera_from_object: Pose,
    /// Of the whole image, the same on all its lines, seconds; -1 if it is not known.
    pub time_s: f64,
}

/// Writes poses: rotations row-major, translations in millimetres.
///
/// # Errors
/// When the file cannot be written.
pub fn write_poses(path: &Path, poses: &[PoseResult]) -> Result<(), ResultsError> {
    let write = || -> Result<(), csv::Error> {
        let mut writer = Writer::from_path(path)?;
        writer.write_record(HEADER)?;
        for pose in poses {
            let rotation = pose.camera_from_object.rotation().matrix().transpose();
            let translation_mm = pose.camera_from_object.translation() / METRES_PER_MILLIMETRE;
            writer.write_record([
                pose.scene_id.to_string(),
                pose.image_id.to_string(),
                pose.obj_id.to_string(),
                pose.score.to_string(),
                spaced(rotation.as_slice()),
                spaced(translation_mm.as_slice()),
                pose.time_s.to_string(),
            ])?;
        }
        Ok(writer.flush()?)
    };
    write().map_err(|error| ResultsError::Write { path: path.into(), source: error.into() })
}

/// Numbers with all their digits: what is read back is what was written.
fn spaced(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// Reads poses, of this or any other method.
///
/// # Errors
/// [`ResultsError`] names the line and the column.
pub fn read_poses(path: &Path) -> Result<Vec<PoseResult>, ResultsError> {
    let unreadable = |error: csv::Error| ResultsError::Read { path: path.into(), source: error.into() };
    let mut reader = Reader::from_path(path).map_err(unreadable)?;
    let header = reader.headers().map_err(unreadable)?;
    if !header.iter().map(str::trim).eq(HEADER) {
        return Err(ResultsError::Header { path: path.into(), header: HEADER.join(",") });
    }
    let mut poses = Vec::new();
    for (place, record) in reader.records().enumerate() {
        // The header is line 1. Nothing in this format needs a line break within quotes.
        let line = place as u64 + 2;
        let wrong = |reason| ResultsError::Line { path: path.into(), line, reason };
        let record = record.map_err(|error| wrong(error.to_string()))?;
        poses.push(parse(&record).map_err(wrong)?);
    }
    let longest_m = poses.iter().map(|pose| pose.camera_from_object.translation().norm()).fold(0.0, f64::max);
    if longest_m > 0.0 && longest_m < METRES_BELOW_MM * METRES_PER_MILLIMETRE {
        return Err(ResultsError::Metres { path: path.into(), limit_mm: METRES_BELOW_MM });
    }
    Ok(poses)
}

fn parse(record: &StringRecord) -> Result<PoseResult, String> {
    let column = |place: usize| record.get(place).unwrap_or_default().trim();
    let whole = |place: usize| -> Result<u32, String> {
        let text = column(place);
        text.parse().map_err(|_| format!("column '{}' is {text:?}; it must be a whole number", HEADER[place]))
    };
    let finite = |place: usize, text: &str| -> Result<f64, String> {
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| format!("column '{}' has {text:?}; it must be a number", HEADER[place]))
    };
    let rotation: [f64; 9] = numbers(&finite, 4, column(4))?;
    let translation_mm: [f64; 3] = numbers(&finite, 5, column(5))?;
    let pose = Pose::from_row_major(rotation, translation_mm.map(|mm| mm * METRES_PER_MILLIMETRE));
    Ok(PoseResult {
        scene_id: whole(0)?,
        image_id: whole(1)?,
        obj_id: whole(2)?,
        score: finite(3, column(3))?,
        camera_from_object: pose.map_err(|error| format!("column 'R': {error}"))?,
        time_s: finite(6, column(6))?,
    })
}

fn numbers<const N: usize>(
    finite: &impl Fn(usize, &str) -> Result<f64, String>,
    place: usize,
    text: &str,
) -> Result<[f64; N], String> {
    let values = text.split_whitespace().map(|word| finite(place, word)).collect::<Result<Vec<_>, _>>()?;
    let count = values.len();
    values.try_into().map_err(|_| format!("column '{}' has {count} numbers; it must have {N}", HEADER[place]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;
    use std::fs;

    fn any_result() -> impl Strategy<Value = PoseResult> {
        let pose = (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(0.1..5.0f64))
            .prop_map(|(r, t)| Pose::new(Rotation3::new(Vector3::from(r)), Vector3::from(t)));
        (0..100u32, 0..10_000u32, 1..40u32, 0.0..1.0f64, pose, 0.0..10.0f64).prop_map(
            |(scene_id, image_id, obj_id, score, camera_from_object, time_s)| PoseResult {
                scene_id,
                image_id,
                obj_id,
                score,
                camera_from_object,
                time_s,
            },
        )
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(poses in prop::collection::vec(any_result(), 0..5)) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("posed_set-test.csv");
            write_poses(&path, &poses).unwrap();
            let read = read_poses(&path).unwrap();
            prop_assert_eq!(read.len(), poses.len());
            for (read, wrote) in read.iter().zip(&poses) {
                let apart = (read.camera_from_object.matrix() - wrote.camera_from_object.matrix()).norm();
                prop_assert!(apart < 1e-12);
                prop_assert_eq!((read.scene_id, read.image_id, read.obj_id), (wrote.scene_id, wrote.image_id, wrote.obj_id));
                prop_assert_eq!((read.score, read.time_s), (wrote.score, wrote.time_s));
            }
        }
    }

    #[test]
    fn what_is_no_pose_names_its_line_and_column() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a_b-c.csv");
        let header = HEADER.join(",");
        let turn = "1 0 0 0 1 0 0 0 1";
        for (text, words) in [
            ("a,b\n1,2\n".to_owned(), "first line"),
            (
                format!("{header}\n1,2,3,0.5,{turn},0 0 500,1\n1,2,3,0.5,{turn},0 0,1\n"),
                "line 3: column 't' has 2 numbers",
            ),
            (format!("{header}\n1,2,3,0.5,2 0 0 0 2 0 0 0 2,0 0 500,1\n"), "line 2: column 'R'"),
            (format!("{header}\n1,2,3,nan,{turn},0 0 500,1\n"), "column 'score'"),
            (format!("{header}\n1,2,3,1,{turn},0 0 0.5,1\n"), "metres"),
            (format!("{header}\n1,2,3\n"), "line 2"),
        ] {
            fs::write(&path, text).unwrap();
            let said = read_poses(&path).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    }
}
