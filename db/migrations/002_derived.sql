-- What the program derives from an object's geometry. Never the only copy: a row that is missing, damaged or of another
-- version is made anew from the other tables. data carries its own layout, version and checksum; version is repeated
-- here so that what is out of date can be counted without reading it.
CREATE TABLE derived (
  object_id TEXT PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  version INTEGER NOT NULL,
  data BLOB NOT NULL
) STRICT;
