-- What the program derives from an object's geometry. Never the only copy: a row that is missing, damaged or of another
-- version is made anew from the other tables. data carries its own layout, version and checksum; version is repeated
-- here so that what is out of date can be counted without reading it.
CREATE TABLE derived (
  object_id TEXT PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  version INTEGER NOT NULL,
  data BLOB NOT NULL
) STRICT;

-- Counts the writes that changed an object's geometry or the set of objects; what is computed from the whole catalog
-- names the generation it saw.
CREATE TABLE catalog_state (
  id INTEGER PRIMARY KEY CHECK (id = 0),
  generation INTEGER NOT NULL
) STRICT;
INSERT INTO catalog_state VALUES (0, 0);
