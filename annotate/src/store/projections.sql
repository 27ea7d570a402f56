-- Projections of the log, for SQLite and PostgreSQL alike: they can be dropped and derived again from `event`.
-- Every row belongs to one task. Times are milliseconds since the epoch.

-- A task.
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
  practice BIGINT NOT NULL,
  extra TEXT,
  state TEXT NOT NULL,
  submitted BIGINT NOT NULL,
  leases BIGINT NOT NULL,
  epoch BIGINT NOT NULL,
  claimable BIGINT NOT NULL,
  came_back BIGINT NOT NULL,
  -- Whether the clip was ingested anew after somebody answered.
  changed BIGINT NOT NULL,
  -- Whether the pair counts toward the quota of its category: it is kept, or somebody is at work on it.
  counted BIGINT NOT NULL,
  -- Edit type that the source states.
  stated_type TEXT,
  -- Edit type that the pair is kept as, in its accepted answer or, before a decision, in a submitted one.
  kept_type TEXT,
  distance DOUBLE PRECISION,
  touched BIGINT NOT NULL
);
CREATE INDEX task_claim ON task (kind, priority DESC, id) WHERE claimable = 1;
CREATE INDEX task_category ON task (kind, category, priority DESC, id) WHERE claimable = 1;
CREATE INDEX task_stated ON task (kind, stated_type, priority DESC, id) WHERE claimable = 1 AND stated_type IS NOT NULL;
CREATE INDEX task_counted ON task (kind, category, kept_type, stated_type) WHERE counted = 1;
CREATE INDEX task_changed ON task (id) WHERE changed = 1;
CREATE INDEX task_state ON task (kind, state);
CREATE INDEX task_review ON task (state, id);
CREATE INDEX task_bundle ON task (bundle, bundle_index);
CREATE INDEX task_distance ON task (COALESCE(distance, -1), id);
CREATE INDEX task_touched ON task (touched, id);
CREATE INDEX task_gold ON task (kind, id) WHERE gold IS NOT NULL;

-- A lease on a task: to answer it, to review it, or to reserve it for an author whose answer was returned or for a
-- person to whom it was assigned.
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

-- The current answer of an author.
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
  words TEXT NOT NULL,
  parts TEXT NOT NULL,
  PRIMARY KEY (task, author)
);
CREATE INDEX revision_mine ON revision (author, at, task);
CREATE INDEX revision_author ON revision (author, state, at);
CREATE INDEX revision_at ON revision (state, at);

-- A decision. `authors` are those whose answers it concerned at that time, each between bars: `|3|5|`.
CREATE TABLE review (
  seq BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  reviewer BIGINT NOT NULL,
  decision TEXT NOT NULL,
  authors TEXT NOT NULL,
  comment TEXT NOT NULL,
  at BIGINT NOT NULL,
  rule TEXT
);
CREATE INDEX review_task ON review (task, seq);

-- The accepted answer. `credit` is the author that an import named; `keeps` is 1 if the answer keeps a fine-grained
-- pair, which then has an edit type.
CREATE TABLE accepted (
  task BIGINT PRIMARY KEY,
  author BIGINT NOT NULL,
  reviewer BIGINT NOT NULL,
  answer TEXT NOT NULL,
  merged BIGINT NOT NULL,
  credit TEXT,
  keeps BIGINT NOT NULL,
  edit_type TEXT,
  at BIGINT NOT NULL,
  seq BIGINT NOT NULL,
  basis TEXT NOT NULL,
  words TEXT NOT NULL,
  parts TEXT NOT NULL
);
CREATE INDEX accepted_seq ON accepted (seq);
CREATE INDEX accepted_basis ON accepted (basis, task);

-- Skipped and postponed tasks by user.
CREATE TABLE skip (
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  postponed BIGINT NOT NULL,
  reason TEXT,
  note TEXT NOT NULL,
  at BIGINT NOT NULL,
  PRIMARY KEY (task, usr)
);

-- Use of suggestions.
CREATE TABLE suggestion_use (
  seq BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  suggestion BIGINT NOT NULL,
  used TEXT NOT NULL
);
CREATE INDEX suggestion_use_task ON suggestion_use (task);

-- Scores of answers to gold and practice tasks.
CREATE TABLE gold_score (
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  score DOUBLE PRECISION NOT NULL,
  at BIGINT NOT NULL,
  PRIMARY KEY (task, usr)
);

-- Work that entries of the log report: seconds, answers, skips and reviews.
CREATE TABLE work (
  seq BIGINT PRIMARY KEY,
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  at BIGINT NOT NULL,
  secs DOUBLE PRECISION NOT NULL,
  answers BIGINT NOT NULL,
  skips BIGINT NOT NULL,
  reviews BIGINT NOT NULL
);
CREATE INDEX work_usr ON work (usr, at);
CREATE INDEX work_at ON work (at);
CREATE INDEX work_task ON work (task);

-- The place in a bundle that a gold task takes for a user, instead of another task.
CREATE TABLE gold_place (
  task BIGINT NOT NULL,
  usr BIGINT NOT NULL,
  bundle BIGINT NOT NULL,
  bundle_index BIGINT NOT NULL,
  PRIMARY KEY (task, usr)
);
CREATE INDEX gold_place_bundle ON gold_place (usr, bundle);
