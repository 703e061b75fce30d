-- What is printed on an object, learnt from images where that was asked for; most objects have none. data: as db/blob.h lays it out.
CREATE TABLE surface_print (
  object_id TEXT NOT NULL PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  sha256 TEXT NOT NULL,
  data BLOB NOT NULL
) STRICT;
-- A print lies on a surface and was learnt under its symmetries: with others it is gone.
CREATE TRIGGER print_of_mesh AFTER DELETE ON mesh BEGIN
  DELETE FROM surface_print WHERE object_id = OLD.object_id;
END;
CREATE TRIGGER print_of_symmetry AFTER DELETE ON symmetry BEGIN
  DELETE FROM surface_print WHERE object_id = OLD.object_id;
END;
CREATE TRIGGER print_of_new_symmetry AFTER INSERT ON symmetry BEGIN
  DELETE FROM surface_print WHERE object_id = NEW.object_id;
END;
