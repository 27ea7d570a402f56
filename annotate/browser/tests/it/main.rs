//! The annotation tool in Chromium, end to end: what a person does at the keyboard, and what then
//! stands on the server. Started by `annotate/browser/run`.

mod access;
mod drafts;
mod masks;
mod nothing_lost;
mod pairs;
mod quick_start;
mod report;
mod review;
mod stage;
mod steps;
