//! Raw files to motions to triplets.
