-- As db/migrations/012. By triggers, so that servers that know nothing of prints do not leave one on another surface.
CREATE TABLE surface_print (
  object_id TEXT COLLATE "C" PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  sha256 TEXT NOT NULL,
  data BYTEA NOT NULL
);
CREATE FUNCTION remove_surface_print() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
  id TEXT;
BEGIN
  IF TG_OP = 'DELETE' THEN id := OLD.object_id; ELSE id := NEW.object_id; END IF;
  EXECUTE format('DELETE FROM %I.surface_print WHERE object_id = $1', TG_TABLE_SCHEMA) USING id;
  RETURN NULL;
END $$;
CREATE TRIGGER print_of_mesh AFTER DELETE ON mesh FOR EACH ROW EXECUTE FUNCTION remove_surface_print();
CREATE TRIGGER print_of_symmetry AFTER DELETE OR INSERT ON symmetry
  FOR EACH ROW EXECUTE FUNCTION remove_surface_print();
