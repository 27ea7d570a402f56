//! Sources at URLs through the command, served by this test.

use std::collections::BTreeMap;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;

use datasets_spec::record::MotionRow;

use crate::archives::{Files, files_below, packed};
use crate::hub::server::Request;
use crate::util::{Ran, arg, command, corpus, motions_of, rows_of, typed_with};

/// Error response of an object store for a missing bucket.
const NO_BUCKET: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Error><Code>NoSuchBucket</Code><Message>The \
                         specified bucket does not exist</Message><BucketName>missing</BucketName></Error>";

/// Serves files on a port of this machine as long as the test runs; requests for other paths get the error of a missing
/// bucket.
fn serve(files: Files) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let files = Arc::new(files);
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let files = Arc::clone(&files);
            std::thread::spawn(move || answer(stream, &files));
        }
    });
    format!("http://{address}")
}

/// Answers the request of a connection.
fn answer(mut stream: TcpStream, files: &Files) -> std::io::Result<()> {
    let request = Request::read(&stream)?;
    let path = request.target.split('?').next().unwrap_or_default();
    let date = "last-modified: Mon, 01 Jan 2024 00:00:00 GMT\r\netag: \"1\"\r\n";
    let (status, head, body) = match (files.get(path.trim_start_matches('/')), request.range) {
        (None, _) => ("404 Not Found", String::new(), NO_BUCKET.as_bytes()),
        (Some(bytes), None) => ("200 OK", date.to_owned(), &bytes[..]),
        (Some(bytes), Some(range)) => {
            let (start, end) = range.split_once('-').unwrap_or(("0", ""));
            let start: usize = start.parse().unwrap_or(0);
            let last = end.parse().unwrap_or(usize::MAX).min(bytes.len() - 1);
            let range = format!("content-range: bytes {start}-{last}/{}\r\n", bytes.len());
            let head = format!("{date}{range}");
            ("206 Partial Content", head, &bytes[start..=last])
        }
    };
    let length = body.len();
    let head =
        format!("HTTP/1.1 {status}\r\ncontent-length: {length}\r\nconnection: close\r\n{head}\r\n");
    stream.write_all(head.as_bytes())?;
    if request.method != "HEAD" {
        stream.write_all(body)?;
    }
    Ok(())
}

/// Ingests a source; buckets are looked up at `endpoint`.
fn ingest(endpoint: &str, source: &str, out: &Path) -> Ran {
    command(&["ingest", source, "--out", arg(out)])
        .env("AWS_ENDPOINT_URL", endpoint)
        .env("AWS_ACCESS_KEY_ID", "key")
        .env("AWS_SECRET_ACCESS_KEY", "secret")
        .env("AWS_REGION", "us-east-1")
        .output()
        .expect("starts")
        .into()
}

#[test]
fn archives_at_urls_are_read_and_a_missing_bucket_is_a_sentence() {
    let dir = corpus(4);
    let files = files_below(&dir.path().join("corpus"));
    let archives = ["all.zip", "all.tar", "all.tar.gz"];
    let served = archives.map(|name| (format!("data/{name}"), packed(name, &files)));
    let server = serve(served.into());
    let clips = |source: &str, out: &str, prefix: &str| -> BTreeMap<String, String> {
        let out = dir.path().join(out);
        ingest(&server, source, &out).expect_code(0);
        let clips = motions_of(&out).into_iter().map(|(id, row)| {
            let id = id.strip_prefix(prefix).unwrap_or_else(|| panic!("{id}"));
            (id.to_owned(), row.content_hash)
        });
        clips.collect()
    };
    let plain = dir.path().join("corpus");
    let expected = clips(arg(&plain), "plain", "");
    for name in archives {
        let found = clips(&format!("{server}/data/{name}"), name, &format!("{name}/"));
        assert_eq!(found, expected, "{name}");
        let (url, out) = (format!("s3://data/{name}"), format!("s3-{name}"));
        let found = clips(&url, &out, &format!("{name}/"));
        assert_eq!(found, expected, "{name} in a bucket");
    }
    let missing = ingest(&server, "s3://missing/clips", &dir.path().join("none"));
    let said = missing.refusal();
    assert!(
        said.contains("there is no bucket missing") && !said.contains('<'),
        "{said}"
    );
}

#[test]
fn a_source_at_a_url_has_the_name_that_it_is_given() {
    let dir = corpus(4);
    let packed = packed("all.zip", &files_below(&dir.path().join("corpus")));
    let files =
        ["anna/bvh/all.zip", "ben/bvh/all.zip"].map(|path| (path.to_owned(), packed.clone()));
    let server = serve(files.into());
    let out = dir.path().join("dataset");
    let ingest = |sources: &[String], code: i32| -> Ran {
        let sources: Vec<&str> = sources.iter().map(String::as_str).collect();
        typed_with("ingest --out {}", &[&out], &sources).expect_code(code)
    };
    let at = |folder: &str| format!("{server}/{folder}/bvh/all.zip");
    let named = |name: &str, folder: &str| format!("{name}={}", at(folder));
    let names = || -> BTreeMap<String, usize> {
        let rows: Vec<MotionRow> = rows_of(&out);
        let mut names = BTreeMap::new();
        for row in rows {
            *names.entry(row.source_name).or_default() += 1;
        }
        names
    };
    ingest(&[at("anna")], 0);
    let alone = names();
    assert_eq!(alone.keys().collect::<Vec<_>>(), ["bvh"]);
    // The same name at another URL is ambiguous, so the user is asked.
    let said = ingest(&[at("ben")], 2).stderr;
    assert!(said.contains(&format!("ben-bvh={}", at("ben"))), "{said}");
    assert_eq!(names(), alone);
    ingest(&[named("ben", "ben")], 0);
    assert_eq!(names()["ben"], alone["bvh"]);
    // The source is recognised by its URL alone.
    let again = ingest(&[at("ben")], 0);
    again.expect_printed("already complete");
}
