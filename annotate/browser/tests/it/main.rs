//! End-to-end tests of the annotation tool in Chromium: keyboard actions, and the resulting data on the
//! server. Started by `annotate/browser/run`.

mod access;
mod by_touch;
mod captures;
mod dashboard;
mod drafts;
mod first_day;
mod guide;
mod masks;
mod nothing_lost;
mod pairs;
mod people;
mod pictures;
mod quick_start;
mod report;
mod review;
mod stage;
mod steps;
mod tasks;
