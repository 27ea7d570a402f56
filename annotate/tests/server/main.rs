//! Integration tests of the annotation server and its store, with a module per topic.

mod api;
mod captures;
mod deployment;
mod figures;
mod hostile;
mod load;
mod model;
mod quotas;
mod scale;
mod simulation;
mod store;
mod styles;
mod support;
mod transfer;
mod versions;
