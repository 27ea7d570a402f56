//! The annotation server and its store, from outside: one binary, a module per topic.

mod api;
mod hostile;
mod load;
mod model;
mod store;
mod support;
mod transfer;
