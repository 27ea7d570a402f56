//! Integration tests of the `stance` command and parity with the reference implementations: one
//! binary, a module per topic.

mod accounting;
mod annotate;
mod answers;
mod archives;
mod baselines;
mod captures;
mod chain;
mod compose;
mod evaluate;
mod evidence;
mod export;
mod exports;
mod fbx;
mod formats;
mod golden;
mod growth;
mod help;
mod ingest;
mod keys;
mod labels;
mod mdm;
mod pairs;
mod reasons;
mod remote;
mod results;
mod round_trips;
mod seams;
mod stage;
mod tables;
mod texts;
mod train;
mod util;
mod variants;
mod versions;
