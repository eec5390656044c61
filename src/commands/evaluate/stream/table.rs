//! The figures of streams as Markdown tables.

use std::fmt::Write as _;

use super::replay::Replayed;
use crate::evaluation::GroupConsistency;

pub(super) fn tables(scenes: &[Replayed]) -> String {
    let mut text = String::from(
        "| scene | images | single images/s | tracked images/s | ratio | with detector % | tracks astray per image |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        let images = scene.images as f64;
        let (single, tracked) = (images / scene.single_s, images / scene.stream_s);
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {single:.1} | {tracked:.1} | {:.2} | {:.0} | {:.3} |",
            scene.scene,
            scene.images,
            tracked / single,
            1e2 * scene.detected as f64 / images,
            scene.astray as f64 / images,
        );
    }
    text.push_str(
        "\nTracks, and single images in brackets:\n\n\
         | scene | object | in view | followed % | identity switches | ADD(-S) % | translation, median (mm) | \
         rotation, median (deg) | spread (mm) | spread (deg) | step (mm) | NEES mean, median | in 95 % |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        for (object, score) in &scene.objects {
            let (tracks, single) = (&score.tracks, &score.single);
            let both =
                |tracks: f64, single: f64, factor: f64| format!("{:.2} ({:.2})", factor * tracks, factor * single);
            let pose = score.consistency.pose.as_ref();
            let nees = pose.map_or("-".into(), |pose| format!("{:.1}, {:.1}", pose.mean, pose.median));
            let within = pose.and_then(GroupConsistency::within_95);
            let _ = writeln!(
                text,
                "| {} | {object} | {} | {:.1} | {} | {:.1} ({:.1}) | {} | {} | {} | {} | {} | {nees} | {} |",
                scene.scene,
                score.instants,
                1e2 * score.followed,
                score.identity_switches,
                1e2 * tracks.right,
                1e2 * single.right,
                both(tracks.translation_m, single.translation_m, 1e3),
                both(tracks.rotation_deg, single.rotation_deg, 1.0),
                both(tracks.spread_m, single.spread_m, 1e3),
                both(tracks.spread_deg, single.spread_deg, 1.0),
                both(tracks.step_m, single.step_m, 1e3),
                within.map_or("-".into(), |share| format!("{:.1} %", 1e2 * share)),
            );
        }
    }
    text
}
