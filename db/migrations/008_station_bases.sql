-- What base_from_camera rests on: whether it was learnt from references or people said it, its standard deviations (radians, metres),
-- and how many requests it was learnt from.
ALTER TABLE station_hand_eye ADD COLUMN learnt INTEGER NOT NULL DEFAULT 0 CHECK (learnt IN (0, 1));
ALTER TABLE station_hand_eye ADD COLUMN rotation_sigma_rad REAL NOT NULL DEFAULT 0.01;
ALTER TABLE station_hand_eye ADD COLUMN position_sigma_m REAL NOT NULL DEFAULT 0.005;
ALTER TABLE station_hand_eye ADD COLUMN requests INTEGER NOT NULL DEFAULT 0;

-- Earlier versions told the learning as an event (StationEvent.KIND_BASE_LEARNT).
UPDATE station_hand_eye SET learnt = 1, requests = 1 WHERE EXISTS (
  SELECT 1 FROM station_event e WHERE e.station_id = station_hand_eye.station_id AND e.kind = 7
    AND instr(' ' || e.camera_ids || ' ', ' ' || station_hand_eye.camera_id || ' ') > 0);
