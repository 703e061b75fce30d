-- Who made the last write, by the name in the access file; '': not known.
ALTER TABLE object ADD COLUMN changed_by TEXT NOT NULL DEFAULT '';

-- What objects were before a write, as db/version_blob.h lays it out. version: the object's revision at that time. changes: what
-- the write that came after it changed, bits of UpdateParts in the order of its members. geometry and cad_file are NULL where that
-- write left them: they are those of the next version that has them, or the object's own. The hash of a CAD file is in the details.
CREATE TABLE object_version (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  version INTEGER NOT NULL,
  update_time TEXT NOT NULL,
  changed_by TEXT NOT NULL,
  changes INTEGER NOT NULL,
  details_sha256 TEXT NOT NULL,
  details BLOB NOT NULL,
  geometry_sha256 TEXT,
  geometry BLOB,
  cad_file BLOB,
  PRIMARY KEY (object_id, version),
  CHECK ((geometry IS NULL) = (geometry_sha256 IS NULL))
) STRICT;
