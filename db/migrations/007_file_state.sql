-- Whether the server that wrote the file has closed it, and how many objects it should hold. While a server has the file open
-- what was written last is in its log beside it: a copy of the file alone lacks it, and looks whole.
CREATE TABLE file_state (
  id INTEGER PRIMARY KEY CHECK (id = 0),
  closed INTEGER NOT NULL CHECK (closed IN (0, 1)),
  object_count INTEGER NOT NULL
) STRICT;
INSERT INTO file_state VALUES (0, 1, (SELECT count(*) FROM object));

CREATE TRIGGER object_added AFTER INSERT ON object BEGIN
  UPDATE file_state SET object_count = object_count + 1;
END;
CREATE TRIGGER object_removed AFTER DELETE ON object BEGIN
  UPDATE file_state SET object_count = object_count - 1;
END;
