//! Prometheus metrics.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Duration;

use crate::lock::lock;

/// Upper bounds of the latency buckets in seconds.
const CLASSES: [f64; 9] = [0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0, 5.0, 15.0];

/// Request counts of a route.
#[derive(Default)]
struct Requests {
    by_status: BTreeMap<u16, u64>,
    by_class: [u64; CLASSES.len()],
    secs: f64,
}

/// Request counts by the method and path of their route.
#[derive(Default)]
pub(crate) struct Metrics(Mutex<BTreeMap<(&'static str, &'static str), Requests>>);

impl Metrics {
    /// Counts a request to a route, by its method and path.
    pub(crate) fn count(&self, route: (&'static str, &'static str), status: u16, took: Duration) {
        let secs = took.as_secs_f64();
        let mut all = lock(&self.0);
        let requests = all.entry(route).or_default();
        *requests.by_status.entry(status).or_default() += 1;
        requests.secs += secs;
        for (count, end) in requests.by_class.iter_mut().zip(CLASSES) {
            *count += u64::from(secs <= end);
        }
    }

    /// Metrics in the Prometheus text format.
    pub(crate) fn text(&self, gauges: &[(&str, &str, i64)]) -> String {
        let mut text = String::new();
        for (name, help, value) in gauges {
            text += &format!("# HELP {name} {help}\n# TYPE {name} gauge\n{name} {value}\n");
        }
        let mut times = String::new();
        text += "# TYPE annotate_requests_total counter\n";
        for ((method, path), requests) in lock(&self.0).iter() {
            let label = format!("method=\"{method}\",path=\"{path}\"");
            for (status, count) in &requests.by_status {
                text +=
                    &format!("annotate_requests_total{{{label},status=\"{status}\"}} {count}\n");
            }
            let name = "annotate_request_seconds";
            for (end, count) in CLASSES.iter().zip(requests.by_class) {
                times += &format!("{name}_bucket{{{label},le=\"{end}\"}} {count}\n");
            }
            let (count, secs) = (requests.by_status.values().sum::<u64>(), requests.secs);
            times += &format!(
                "{name}_bucket{{{label},le=\"+Inf\"}} {count}\n{name}_sum{{{label}}} {secs}\n{name}_count{{{label}}} {count}\n"
            );
        }
        text + "# TYPE annotate_request_seconds histogram\n" + &times
    }
}
