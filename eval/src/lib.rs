//! Metrics, protocols, tables and reports.
