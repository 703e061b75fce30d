-- Where the gripper waits before the grasp: object_from_pregrasp as in grasp; all NULL: not given.
ALTER TABLE grasp ADD COLUMN pre_r11 REAL;
ALTER TABLE grasp ADD COLUMN pre_r12 REAL;
ALTER TABLE grasp ADD COLUMN pre_r13 REAL;
ALTER TABLE grasp ADD COLUMN pre_r21 REAL;
ALTER TABLE grasp ADD COLUMN pre_r22 REAL;
ALTER TABLE grasp ADD COLUMN pre_r23 REAL;
ALTER TABLE grasp ADD COLUMN pre_r31 REAL;
ALTER TABLE grasp ADD COLUMN pre_r32 REAL;
ALTER TABLE grasp ADD COLUMN pre_r33 REAL;
ALTER TABLE grasp ADD COLUMN pre_tx REAL;
ALTER TABLE grasp ADD COLUMN pre_ty REAL;
ALTER TABLE grasp ADD COLUMN pre_tz REAL;

-- The invariant keys of an object, derived as the rest of its data but read without it: the index over a large catalog is
-- made from these alone. Written with the row in derived; the version is that one's.
CREATE TABLE derived_keys (
  object_id TEXT PRIMARY KEY REFERENCES derived ON DELETE CASCADE,
  data BLOB NOT NULL
) STRICT;
