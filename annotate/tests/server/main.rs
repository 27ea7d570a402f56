//! Integration tests of the annotation server and its store, with a module per topic. They are a package of their own
//! so that a change of `pipeline` does not compile the unit tests of `annotate` again.

mod api;
mod bundle;
mod captures;
mod deployment;
mod figures;
mod fixture;
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
