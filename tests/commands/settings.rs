//! Settings, and what the shell is told.

use std::fs;

use crate::support::{FREE_PORTS, explanation, posed, refuses_to_serve, run};

#[test]
fn the_printed_settings_are_a_file_of_settings_and_wrong_ones_are_refused() {
    let printed = String::from_utf8(run(&["serve", "--print-config"]).stdout).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("posed.toml");
    let with_file = |text: &str, words: &str| {
        fs::write(&path, text).unwrap();
        refuses_to_serve(&["--config", path.to_str().unwrap(), "--timeout-ms", "90000"], words);
    };
    // Wrong only in the flag beside it.
    with_file(&printed, "'timeout_ms' is 90000, but the maximum is 60000 ('max_timeout_ms')");
    let name = path.to_str().unwrap();
    with_file(&format!("{printed}\nquue = 3\n"), &format!("{name}: unknown setting 'quue'; did you mean 'queue'?"));
    with_file("queue = 0", &format!("{name}: setting 'queue' is 0: it must be a whole number from 1 to 65536"));
    let said = explanation(&posed(&["serve", "--print-config"]).env("POSED_QUEUE", "many").output().unwrap());
    assert!(said.contains("'many' for '--queue <QUEUE>'") && said.contains("from 1 to 65536"), "{said}");
    refuses_to_serve(&["--config", "nowhere.toml"], "cannot read nowhere.toml");
    refuses_to_serve(&["--provider", "cuda"], "'cuda'");
    refuses_to_serve(&["--log", "info,posd=debug"], "setting 'log' is \"info,posd=debug\": unknown target \"posd\"");
    refuses_to_serve(&["--max-pixels", "0"], "'0' for '--max-pixels <MAX_PIXELS>': it must be a whole number from 256");
}

/// Seen in what is said of two settings that contradict each other.
#[test]
fn flags_win_over_the_environment_the_environment_over_the_file_and_the_file_over_the_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("posed.toml");
    let timeouts = |file: &str, environment: &[(&str, &str)], flags: &[&str], expected: [u32; 2]| {
        fs::write(&path, file).unwrap();
        let by_flag = posed(&["serve", "--config", path.to_str().unwrap()]);
        let mut by_environment = posed(&["serve"]);
        by_environment.env("POSED_CONFIG", &path);
        for mut command in [by_flag, by_environment] {
            let output = command.args(FREE_PORTS).envs(environment.iter().copied()).args(flags).output().unwrap();
            let [timeout, longest] = expected;
            let words = format!("'timeout_ms' is {timeout}, but the maximum is {longest} ('max_timeout_ms')");
            let said = explanation(&output);
            assert!(said.contains(&words), "{said}");
        }
    };
    let (file, environment) = ("max_timeout_ms = 100\n", [("POSED_TIMEOUT_MS", "300")]);
    timeouts(file, &[], &[], [10_000, 100]);
    timeouts(&format!("{file}timeout_ms = 200\n"), &[], &[], [200, 100]);
    timeouts(&format!("{file}timeout_ms = 200\n"), &environment, &[], [300, 100]);
    timeouts(&format!("{file}timeout_ms = 200\n"), &environment, &["--timeout-ms", "400"], [400, 100]);
}

#[test]
fn completions_know_the_sub_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let text = String::from_utf8(run(&["completions", shell]).stdout).unwrap();
        assert!(text.contains("healthcheck") && text.contains("calibrate"));
    }
}
