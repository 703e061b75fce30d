-- Fixed cameras of a cell and what was learnt of them. state: byte layout in server/vision/geometry/station_blob.h.
CREATE TABLE station (
  station_id TEXT PRIMARY KEY CHECK (length(station_id) BETWEEN 1 AND 63),
  display_name TEXT NOT NULL,
  create_time TEXT NOT NULL,
  update_time TEXT NOT NULL,
  revision INTEGER NOT NULL,           -- number of the write in station_writes, never used twice
  agreed_request_id TEXT NOT NULL,     -- the last request that agreed with what was known; '': none
  agreed_time TEXT NOT NULL,
  state BLOB NOT NULL
) STRICT;

-- base_from_camera, x -> R x + t; R row by row: where people say that a camera is in the robot's base frame.
CREATE TABLE station_hand_eye (
  station_id TEXT NOT NULL REFERENCES station ON DELETE CASCADE,
  camera_id TEXT NOT NULL,
  r11 REAL NOT NULL, r12 REAL NOT NULL, r13 REAL NOT NULL,
  r21 REAL NOT NULL, r22 REAL NOT NULL, r23 REAL NOT NULL,
  r31 REAL NOT NULL, r32 REAL NOT NULL, r33 REAL NOT NULL,
  tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
  PRIMARY KEY (station_id, camera_id)
) STRICT, WITHOUT ROWID;

-- What was noticed of a station; the oldest go.
CREATE TABLE station_event (
  sequence INTEGER PRIMARY KEY,
  station_id TEXT NOT NULL REFERENCES station ON DELETE CASCADE,
  kind INTEGER NOT NULL,               -- StationEvent.Kind
  time TEXT NOT NULL,
  request_id TEXT NOT NULL,
  camera_ids TEXT NOT NULL,            -- separated by spaces
  detail TEXT NOT NULL
) STRICT;
CREATE INDEX station_event_of ON station_event (station_id, sequence);

-- Counts the writes of stations.
CREATE TABLE station_writes (
  id INTEGER PRIMARY KEY CHECK (id = 0),
  writes INTEGER NOT NULL
) STRICT;
INSERT INTO station_writes VALUES (0, 0);
