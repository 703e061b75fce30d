-- The generation of the write that made an object what it is: unique in the catalog, also over delete and create. Every
-- write counts, not only those of geometry.
ALTER TABLE object ADD COLUMN revision INTEGER NOT NULL DEFAULT 0;
UPDATE catalog_state SET generation = generation + 1 WHERE EXISTS (SELECT 1 FROM object);
UPDATE object SET revision = (SELECT generation FROM catalog_state);

-- What people and programs tag objects with.
CREATE TABLE label (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  key TEXT NOT NULL,
  value TEXT NOT NULL,
  PRIMARY KEY (object_id, key)
) STRICT, WITHOUT ROWID;

-- 0: two fingers (jaw_opening_m, grip_width_m); 1: a suction cup (cup_radius_m).
ALTER TABLE grasp ADD COLUMN kind INTEGER NOT NULL DEFAULT 0 CHECK (kind IN (0, 1));
ALTER TABLE grasp ADD COLUMN cup_radius_m REAL NOT NULL DEFAULT 0;

-- Creations that a client may repeat: written with the objects, so that a repetition is answered as the first time. The
-- oldest go.
CREATE TABLE create_request (
  sequence INTEGER PRIMARY KEY,
  request_id TEXT NOT NULL UNIQUE,
  digest TEXT NOT NULL,      -- SHA-256 of the request
  object_ids TEXT NOT NULL   -- separated by spaces
) STRICT;
