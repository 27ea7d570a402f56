//! One module per verb: its arguments, and the library functions it calls.

pub(crate) mod annotate;
pub(crate) mod build;
pub(crate) mod completions;
pub(crate) mod corpus;
pub(crate) mod dataset;
pub(crate) mod demo;
pub(crate) mod doctor;
pub(crate) mod edit;
pub(crate) mod edits;
pub(crate) mod eval;
pub(crate) mod export;
pub(crate) mod ingest;
pub(crate) mod inspect;
pub(crate) mod items;
pub(crate) mod masks;
pub(crate) mod model;
pub(crate) mod page;
pub(crate) mod pairs;
pub(crate) mod render;
pub(crate) mod reproduce;
pub(crate) mod run;
pub(crate) mod stats;
pub(crate) mod train;
pub(crate) mod triplets;
pub(crate) mod variants;
pub(crate) mod verify;
