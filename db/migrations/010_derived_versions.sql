-- Two versions of the program may each keep what they derive of an object. address: SHA-256 of all that it was derived from, the
-- object's shape and the version (db/object_digest.h); it names the data in caches. '': gets one when the file is opened.
CREATE TABLE derived_of (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  version INTEGER NOT NULL,
  address TEXT NOT NULL,
  data BLOB NOT NULL,
  PRIMARY KEY (object_id, version)
) STRICT;
INSERT INTO derived_of SELECT object_id, version, '', data FROM derived;

CREATE TABLE keys_of (
  object_id TEXT NOT NULL,
  version INTEGER NOT NULL,
  data BLOB NOT NULL,
  PRIMARY KEY (object_id, version),
  FOREIGN KEY (object_id, version) REFERENCES derived_of (object_id, version) ON DELETE CASCADE
) STRICT;
INSERT INTO keys_of SELECT k.object_id, d.version, k.data FROM derived_keys k JOIN derived d ON d.object_id = k.object_id;

DROP TABLE derived_keys;
DROP TABLE derived;
ALTER TABLE derived_of RENAME TO derived;
ALTER TABLE keys_of RENAME TO derived_keys;
-- Who asks what there is reads no data.
CREATE INDEX derived_address ON derived (object_id, version, address);
CREATE INDEX derived_unnamed ON derived (object_id, version) WHERE address = '';
