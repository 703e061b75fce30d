-- SHA-256 of all that a robot uses of an object: geometry, symmetries and grasps as db/object_digest.h lays them out. An
-- object that no longer has its digest is damaged. '': enrolled before there were digests; gets one when the file is opened.
CREATE TABLE object_digest (
  object_id TEXT PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  sha256 TEXT NOT NULL
) STRICT, WITHOUT ROWID;
INSERT INTO object_digest SELECT object_id, '' FROM object;
