-- As db/migrations/010. Servers of before write rows of one version an object: they do not start on this schema any more.
CREATE TABLE derived_of (
  object_id TEXT COLLATE "C" NOT NULL REFERENCES object ON DELETE CASCADE,
  version BIGINT NOT NULL,
  address TEXT NOT NULL,
  data BYTEA NOT NULL,
  PRIMARY KEY (object_id, version)
);
INSERT INTO derived_of SELECT object_id, version, '', data FROM derived;

CREATE TABLE keys_of (
  object_id TEXT COLLATE "C" NOT NULL,
  version BIGINT NOT NULL,
  data BYTEA NOT NULL,
  PRIMARY KEY (object_id, version),
  FOREIGN KEY (object_id, version) REFERENCES derived_of ON DELETE CASCADE
);
INSERT INTO keys_of SELECT k.object_id, d.version, k.data FROM derived_keys k JOIN derived d ON d.object_id = k.object_id;

DROP TABLE derived_keys;
DROP TABLE derived;
ALTER TABLE derived_of RENAME TO derived;
ALTER TABLE keys_of RENAME TO derived_keys;
-- Who asks what there is reads no data.
CREATE INDEX derived_address ON derived (object_id, version, address);
CREATE INDEX derived_unnamed ON derived (object_id, version) WHERE address = '';
UPDATE catalog_schema SET usable_from = 2;
