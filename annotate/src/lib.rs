//! Masks and descriptions by people: drafts out, checked judgements in.
