//! Prometheus metrics.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Mutex;
use std::time::Duration;

use crate::lock::lock;

/// Upper bounds of the latency buckets in seconds.
const CLASSES: [f64; 9] = [0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0, 5.0, 15.0];

#[derive(Debug, Default, Clone)]
struct Times {
    classes: [u64; CLASSES.len()],
    count: u64,
    sum: f64,
}

/// Requests by route and status, and their latencies.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    requests: Mutex<BTreeMap<(&'static str, &'static str, u16), u64>>,
    times: Mutex<BTreeMap<(&'static str, &'static str), Times>>,
}

impl Metrics {
    pub(crate) fn count(
        &self,
        method: &'static str,
        path: &'static str,
        status: u16,
        took: Duration,
    ) {
        *lock(&self.requests)
            .entry((method, path, status))
            .or_default() += 1;
        let secs = took.as_secs_f64();
        let mut times = lock(&self.times);
        let times = times.entry((method, path)).or_default();
        times.count += 1;
        times.sum += secs;
        for (class, end) in times.classes.iter_mut().zip(CLASSES) {
            *class += u64::from(secs <= end);
        }
    }

    /// Metrics in the Prometheus text format.
    pub(crate) fn text(&self, gauges: &[(&str, &str, i64)]) -> String {
        let mut text = String::new();
        for (name, help, value) in gauges {
            // Writing to a string cannot fail.
            let _written = writeln!(
                text,
                "# HELP {name} {help}\n# TYPE {name} gauge\n{name} {value}"
            );
        }
        text += "# TYPE annotate_requests_total counter\n";
        for ((method, path, status), count) in lock(&self.requests).iter() {
            let _written = writeln!(
                text,
                "annotate_requests_total{{method=\"{method}\",path=\"{path}\",status=\"{status}\"}} {count}"
            );
        }
        text += "# TYPE annotate_request_seconds histogram\n";
        for ((method, path), times) in lock(&self.times).iter() {
            let label = format!("method=\"{method}\",path=\"{path}\"");
            for (end, count) in CLASSES.iter().zip(times.classes) {
                let _written = writeln!(
                    text,
                    "annotate_request_seconds_bucket{{{label},le=\"{end}\"}} {count}"
                );
            }
            let _written = writeln!(
                text,
                "annotate_request_seconds_bucket{{{label},le=\"+Inf\"}} {}\nannotate_request_seconds_sum{{{label}}} {}\nannotate_request_seconds_count{{{label}}} {}",
                times.count, times.sum, times.count
            );
        }
        text
    }
}
