-- As db/migrations/011. By a trigger, so that servers that know nothing of it make them, too, and whatever search_path is set.
CREATE TABLE catalog_write (
  generation BIGINT PRIMARY KEY,
  token TEXT NOT NULL
);
INSERT INTO catalog_write SELECT generation, gen_random_uuid()::text FROM catalog_state;
CREATE FUNCTION name_catalog_write() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  EXECUTE format('DELETE FROM %I.catalog_write WHERE generation >= $1 OR generation < $1 - 100000', TG_TABLE_SCHEMA)
    USING NEW.generation;
  EXECUTE format('INSERT INTO %I.catalog_write VALUES ($1, gen_random_uuid()::text)', TG_TABLE_SCHEMA) USING NEW.generation;
  RETURN NULL;
END $$;
CREATE TRIGGER catalog_write_named AFTER INSERT OR UPDATE OF generation ON catalog_state
  FOR EACH ROW EXECUTE FUNCTION name_catalog_write();
