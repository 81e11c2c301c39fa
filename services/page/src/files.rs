//! The files that a browser gets, compressed once at the start. They are part of the program.

use std::io::Write;

use axum::body::Bytes;
use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use flate2::write::GzEncoder;
use flate2::{Compression, Crc};

/// Name, media type and content of each file in `web`; the first is the page itself.
const FILES: [(&str, &str, &[u8]); 22] = [
    ("index.html", "text/html; charset=utf-8", include_bytes!("../web/index.html")),
    ("actions.js", SCRIPT, include_bytes!("../web/actions.js")),
    ("app.js", SCRIPT, include_bytes!("../web/app.js")),
    ("arm.js", SCRIPT, include_bytes!("../web/arm.js")),
    ("calibration.js", SCRIPT, include_bytes!("../web/calibration.js")),
    ("connection.js", SCRIPT, include_bytes!("../web/connection.js")),
    ("hands.svg", "image/svg+xml", include_bytes!("../web/hands.svg")),
    ("icon.svg", "image/svg+xml", include_bytes!("../web/icon.svg")),
    ("latency.js", SCRIPT, include_bytes!("../web/latency.js")),
    ("next.js", SCRIPT, include_bytes!("../web/next.js")),
    ("orders.js", SCRIPT, include_bytes!("../web/orders.js")),
    ("outcome.js", SCRIPT, include_bytes!("../web/outcome.js")),
    ("paint.js", SCRIPT, include_bytes!("../web/paint.js")),
    ("recognition.js", SCRIPT, include_bytes!("../web/recognition.js")),
    ("requests.js", SCRIPT, include_bytes!("../web/requests.js")),
    ("session.js", SCRIPT, include_bytes!("../web/session.js")),
    ("state.js", SCRIPT, include_bytes!("../web/state.js")),
    ("style.css", "text/css; charset=utf-8", include_bytes!("../web/style.css")),
    ("task.js", SCRIPT, include_bytes!("../web/task.js")),
    ("texts.js", SCRIPT, include_bytes!("../web/texts.js")),
    ("texts.json", "application/json", include_bytes!("../web/texts.json")),
    ("traces.js", SCRIPT, include_bytes!("../web/traces.js")),
];
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// All files.
#[derive(Debug)]
pub struct Files(Vec<File>);

#[derive(Debug)]
struct File {
    name: &'static str,
    media_type: &'static str,
    content: &'static [u8],
    compressed: Bytes,
    tag: String,
}

impl Files {
    /// Compresses all files.
    ///
    /// # Errors
    ///
    /// When there is no memory for it.
    pub fn new() -> std::io::Result<Files> {
        let file = |(name, media_type, content): (&'static str, &'static str, &'static [u8])| {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
            encoder.write_all(content)?;
            let mut checksum = Crc::new();
            checksum.update(content);
            let tag = format!("\"{:08x}-{}\"", checksum.sum(), content.len());
            Ok(File { name, media_type, content, compressed: encoder.finish()?.into(), tag })
        };
        FILES.into_iter().map(file).collect::<std::io::Result<Vec<File>>>().map(Files)
    }

    /// The answer to a request for `path`.
    pub fn answer(&self, path: &str, asked: &HeaderMap) -> Response {
        let name = path.strip_prefix('/').filter(|name| !name.is_empty()).unwrap_or(FILES[0].0);
        let Some(file) = self.0.iter().find(|file| file.name == name) else {
            return (StatusCode::NOT_FOUND, "there is no such file").into_response();
        };
        let says = |header, words: &str| {
            asked.get(header).and_then(|value| value.to_str().ok()).is_some_and(|value| value.contains(words))
        };
        let headers = [(CACHE_CONTROL, "no-cache"), (VARY, "accept-encoding"), (ETAG, file.tag.as_str())];
        if says(IF_NONE_MATCH, &file.tag) {
            return (StatusCode::NOT_MODIFIED, headers).into_response();
        }
        let kind = [(CONTENT_TYPE, file.media_type)];
        if says(ACCEPT_ENCODING, "gzip") {
            (headers, kind, [(CONTENT_ENCODING, "gzip")], file.compressed.clone()).into_response()
        } else {
            (headers, kind, Bytes::from_static(file.content)).into_response()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_served_and_nothing_else() {
        let files = Files::new().unwrap();
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/web");
        let mut names = Vec::new();
        for entry in std::fs::read_dir(folder).unwrap() {
            names.push(entry.unwrap().file_name().into_string().unwrap());
        }
        assert_eq!(names.len(), FILES.len(), "{names:?}");
        let mut asked = HeaderMap::new();
        for name in names {
            assert_eq!(files.answer(&format!("/{name}"), &asked).status(), StatusCode::OK, "{name}");
        }
        assert_eq!(files.answer("/", &asked).status(), StatusCode::OK);
        for path in ["/../Cargo.toml", "/web/app.js", "/app.js/", "//etc/passwd"] {
            assert_eq!(files.answer(path, &asked).status(), StatusCode::NOT_FOUND, "{path}");
        }
        asked.insert(ACCEPT_ENCODING, "br, gzip".parse().unwrap());
        let answer = files.answer("/app.js", &asked);
        assert_eq!(answer.headers()[CONTENT_ENCODING], "gzip");
        asked.insert(IF_NONE_MATCH, answer.headers()[ETAG].clone());
        assert_eq!(files.answer("/app.js", &asked).status(), StatusCode::NOT_MODIFIED);
    }
}
