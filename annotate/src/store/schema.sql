-- Tables of the annotation store that are not derived, for SQLite and PostgreSQL alike: the log (`event`) and
-- what is not part of it. Times are milliseconds since the epoch. `projections.sql` has the tables derived from
-- the log; `migrate.rs` says how to change either.

CREATE TABLE event (
  seq BIGINT PRIMARY KEY,
  at BIGINT NOT NULL,
  actor BIGINT,
  kind TEXT NOT NULL,
  task BIGINT,
  idem_key TEXT UNIQUE,
  epoch BIGINT,
  base_rev BIGINT,
  body TEXT NOT NULL,
  result TEXT,
  version BIGINT NOT NULL
);
CREATE INDEX event_task ON event (task, seq);
CREATE INDEX event_actor ON event (actor, seq);
CREATE INDEX event_kind ON event (kind, seq);

CREATE TABLE suggestion (
  id BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  source TEXT NOT NULL,
  parts TEXT NOT NULL,
  text TEXT NOT NULL,
  model TEXT NOT NULL,
  prompt_hash TEXT NOT NULL,
  params TEXT NOT NULL,
  tokens BIGINT,
  response_hash TEXT NOT NULL,
  at BIGINT NOT NULL
);
CREATE INDEX suggestion_task ON suggestion (task, id);
CREATE INDEX suggestion_prompt ON suggestion (prompt_hash);

-- Motions by their content. `current` is 0 for the earlier content of a clip that was ingested anew, and 2 for a clip that
-- is no longer in the dataset.
CREATE TABLE motion (
  hash TEXT PRIMARY KEY,
  id TEXT NOT NULL,
  split TEXT NOT NULL,
  frames BIGINT NOT NULL,
  fps DOUBLE PRECISION NOT NULL,
  captions TEXT NOT NULL,
  style TEXT,
  action TEXT,
  current BIGINT NOT NULL
);
CREATE UNIQUE INDEX motion_id ON motion (id) WHERE current = 1;

CREATE TABLE usr (
  id BIGINT PRIMARY KEY,
  name TEXT NOT NULL UNIQUE,
  role TEXT NOT NULL,
  active BIGINT NOT NULL,
  created BIGINT NOT NULL
);

CREATE TABLE token (
  id BIGINT PRIMARY KEY,
  usr BIGINT NOT NULL,
  hash TEXT NOT NULL UNIQUE,
  purpose TEXT NOT NULL,
  created BIGINT NOT NULL,
  expires BIGINT NOT NULL,
  last_used BIGINT,
  revoked BIGINT NOT NULL
);
CREATE INDEX token_usr ON token (usr);

CREATE TABLE pref (usr BIGINT PRIMARY KEY, body TEXT NOT NULL);
CREATE TABLE setting (name TEXT PRIMARY KEY, body TEXT NOT NULL);

CREATE TABLE job (
  id BIGINT PRIMARY KEY,
  body TEXT NOT NULL
);

-- Files of exports, in parts, for servers that share a store.
CREATE TABLE job_file (
  job BIGINT NOT NULL,
  name TEXT NOT NULL,
  part BIGINT NOT NULL,
  bytes BYTEA NOT NULL,
  PRIMARY KEY (job, name, part)
);

CREATE TABLE picture (
  name TEXT PRIMARY KEY,
  mime TEXT NOT NULL,
  bytes TEXT NOT NULL,
  at BIGINT NOT NULL
);

