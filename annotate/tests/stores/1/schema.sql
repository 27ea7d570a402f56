-- Tables of the annotation store, for SQLite and PostgreSQL alike. Times are milliseconds since the
-- epoch. `event` is the truth; the tables marked (p) are projections of it and can be rebuilt.

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

-- (p) A task.
CREATE TABLE task (
  id BIGINT PRIMARY KEY,
  key TEXT NOT NULL UNIQUE,
  kind TEXT NOT NULL,
  source TEXT NOT NULL,
  target TEXT,
  split TEXT NOT NULL,
  bundle BIGINT,
  bundle_index BIGINT NOT NULL,
  category TEXT,
  hint TEXT,
  style TEXT,
  priority BIGINT NOT NULL,
  shuffle BIGINT NOT NULL,
  wanted BIGINT NOT NULL,
  gold TEXT,
  extra TEXT,
  state TEXT NOT NULL,
  submitted BIGINT NOT NULL,
  leases BIGINT NOT NULL,
  epoch BIGINT NOT NULL,
  claimable BIGINT NOT NULL,
  came_back BIGINT NOT NULL,
  distance DOUBLE PRECISION
);
CREATE INDEX task_claim ON task (kind, priority DESC, id) WHERE claimable = 1;
CREATE INDEX task_state ON task (kind, state);
CREATE INDEX task_review ON task (state, id);
CREATE INDEX task_bundle ON task (bundle, bundle_index);
CREATE INDEX task_gold ON task (kind, id) WHERE gold IS NOT NULL;

-- (p) A lease on a task: to answer it, to review it, or reserved for an author whose answer was returned.
CREATE TABLE lease (
  id BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  epoch BIGINT NOT NULL,
  expires BIGINT NOT NULL,
  purpose TEXT NOT NULL,
  blind BIGINT NOT NULL,
  UNIQUE (task, usr)
);
CREATE INDEX lease_expires ON lease (expires);
CREATE INDEX lease_usr ON lease (usr, purpose);

-- (p) The current answer of an author.
CREATE TABLE revision (
  task BIGINT NOT NULL,
  author BIGINT NOT NULL,
  rev BIGINT NOT NULL,
  state TEXT NOT NULL,
  answer TEXT NOT NULL,
  at BIGINT NOT NULL,
  secs DOUBLE PRECISION NOT NULL,
  blind BIGINT NOT NULL,
  verdict TEXT,
  edit_type TEXT,
  PRIMARY KEY (task, author)
);
CREATE INDEX revision_author ON revision (author, state, at);
CREATE INDEX revision_at ON revision (state, at);

-- (p) A decision.
CREATE TABLE review (
  seq BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  reviewer BIGINT NOT NULL,
  decision TEXT NOT NULL,
  author BIGINT,
  comment TEXT NOT NULL,
  at BIGINT NOT NULL
);
CREATE INDEX review_task ON review (task, seq);

-- (p) The accepted answer.
CREATE TABLE accepted (
  task BIGINT PRIMARY KEY,
  author BIGINT NOT NULL,
  reviewer BIGINT NOT NULL,
  answer TEXT NOT NULL,
  merged BIGINT NOT NULL,
  at BIGINT NOT NULL,
  seq BIGINT NOT NULL
);
CREATE INDEX accepted_seq ON accepted (seq);

-- (p) Skipped and postponed tasks by user.
CREATE TABLE skip (
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  postponed BIGINT NOT NULL,
  reason TEXT,
  note TEXT NOT NULL,
  at BIGINT NOT NULL,
  PRIMARY KEY (task, usr)
);

-- (p) Use of suggestions.
CREATE TABLE suggestion_use (
  seq BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  suggestion BIGINT NOT NULL,
  used TEXT NOT NULL
);

-- (p) Scores of answers to gold tasks.
CREATE TABLE gold_score (
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  score DOUBLE PRECISION NOT NULL,
  at BIGINT NOT NULL,
  PRIMARY KEY (task, usr)
);

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

CREATE TABLE motion (
  hash TEXT PRIMARY KEY,
  id TEXT NOT NULL UNIQUE,
  split TEXT NOT NULL,
  frames BIGINT NOT NULL,
  fps DOUBLE PRECISION NOT NULL,
  captions TEXT NOT NULL,
  style TEXT,
  action TEXT
);

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
