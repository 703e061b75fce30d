-- The last 100,000 writes of the catalog, each with a random token that no other write has: whoever follows finds out whether what
-- it has seen is in the history of what is there. Not copied with a catalog: a copy is a history of its own.
CREATE TABLE catalog_write (
  generation INTEGER PRIMARY KEY,
  token TEXT NOT NULL
) STRICT;
INSERT INTO catalog_write SELECT generation, lower(hex(randomblob(16))) FROM catalog_state;
CREATE TRIGGER catalog_write_named AFTER UPDATE OF generation ON catalog_state BEGIN
  DELETE FROM catalog_write WHERE generation >= NEW.generation OR generation < NEW.generation - 100000;
  INSERT INTO catalog_write VALUES (NEW.generation, lower(hex(randomblob(16))));
END;
CREATE TRIGGER catalog_write_named_anew AFTER INSERT ON catalog_state BEGIN
  DELETE FROM catalog_write WHERE generation >= NEW.generation OR generation < NEW.generation - 100000;
  INSERT INTO catalog_write VALUES (NEW.generation, lower(hex(randomblob(16))));
END;
