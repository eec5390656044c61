//! Lines of the log: none is so long that a collector cuts it.

use std::io::{self, Write};

use serde_json::Value;
use tracing_subscriber::fmt::MakeWriter;

use super::settings::LogFormat;

/// With the line's end.
const MAX_BYTES: usize = 4096;
/// What is left of a long text in a line that is too long.
const MAX_TEXT_CHARS: usize = 200;

/// Writes lines to stderr.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lines {
    pub format: LogFormat,
}

impl<'a> MakeWriter<'a> for Lines {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        *self
    }
}

impl Write for Lines {
    /// Called once for each line.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let mut stderr = io::stderr().lock();
        if line.len() <= MAX_BYTES {
            stderr.write_all(line)?;
        } else {
            stderr.write_all(shortened(self.format, line).as_bytes())?;
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

fn shortened(format: LogFormat, line: &[u8]) -> String {
    let text = String::from_utf8_lossy(line);
    let json = matches!(format, LogFormat::Json).then(|| serde_json::from_str::<Value>(&text).ok()).flatten();
    let mut short = match json {
        Some(mut value) => {
            shorten(&mut value);
            value.to_string()
        }
        None => text.trim_end().to_owned(),
    };
    if short.len() >= MAX_BYTES {
        let end = (0..=MAX_BYTES - 4).rev().find(|end| short.is_char_boundary(*end)).unwrap_or(0);
        short = match format {
            LogFormat::Pretty => format!("{}…", &short[..end]),
            LogFormat::Json => r#"{"level":"WARN","message":"a line of the log was too long"}"#.to_owned(),
        };
    }
    short.push('\n');
    short
}

fn shorten(value: &mut Value) {
    match value {
        Value::String(text) => {
            if let Some((end, _)) = text.char_indices().nth(MAX_TEXT_CHARS) {
                text.truncate(end);
                text.push('…');
            }
        }
        Value::Array(values) => values.iter_mut().for_each(shorten),
        Value::Object(fields) => fields.values_mut().for_each(shorten),
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_are_cut_and_stay_what_they_are() {
        let long = "ä".repeat(5000);
        let pretty = shortened(LogFormat::Pretty, format!("INFO {long}\n").as_bytes());
        assert!(pretty.len() <= MAX_BYTES && pretty.starts_with("INFO ä") && pretty.ends_with("…\n"));
        let line = serde_json::json!({"ms": 7, "span": {"id": long}, "message": "said"}).to_string();
        let json: Value = serde_json::from_str(&shortened(LogFormat::Json, line.as_bytes())).unwrap();
        assert_eq!((&json["ms"], &json["message"]), (&7.into(), &"said".into()));
        assert_eq!(json["span"]["id"].as_str().unwrap().chars().count(), MAX_TEXT_CHARS + 1);
        let many: Vec<String> = vec![long; 100];
        let json = shortened(LogFormat::Json, serde_json::json!(many).to_string().as_bytes());
        assert!(json.len() <= MAX_BYTES && serde_json::from_str::<Value>(&json).is_ok());
    }
}
