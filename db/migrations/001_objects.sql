-- Known parts. Lengths in metres, angles in radians, every frame is the object's own.
CREATE TABLE object (
  object_id TEXT PRIMARY KEY CHECK (length(object_id) BETWEEN 1 AND 63),
  display_name TEXT NOT NULL,
  diameter_m REAL NOT NULL CHECK (diameter_m > 0),
  create_time TEXT NOT NULL,  -- RFC 3339, UTC, as the server passes it in
  update_time TEXT NOT NULL,
  vertex_count INTEGER NOT NULL,
  edge_count INTEGER NOT NULL,
  triangle_count INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE vertex (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  idx INTEGER NOT NULL CHECK (idx >= 0),
  x REAL NOT NULL,
  y REAL NOT NULL,
  z REAL NOT NULL,
  PRIMARY KEY (object_id, idx)
) STRICT, WITHOUT ROWID;

-- polyline: byte layout in db/blob.h.
CREATE TABLE edge (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  idx INTEGER NOT NULL CHECK (idx >= 0),
  kind INTEGER NOT NULL CHECK (kind IN (0, 1, 2)),  -- line, circle, other
  start_vertex INTEGER,                             -- NULL with end_vertex: closed curve
  end_vertex INTEGER,
  dihedral_rad REAL NOT NULL,
  polyline BLOB NOT NULL,
  PRIMARY KEY (object_id, idx),
  CHECK ((start_vertex IS NULL) = (end_vertex IS NULL)),
  FOREIGN KEY (object_id, start_vertex) REFERENCES vertex (object_id, idx)
    DEFERRABLE INITIALLY DEFERRED,
  FOREIGN KEY (object_id, end_vertex) REFERENCES vertex (object_id, idx)
    DEFERRABLE INITIALLY DEFERRED
) STRICT;

-- The foreign keys on vertex need these when an object is deleted.
CREATE INDEX edge_start ON edge (object_id, start_vertex);
CREATE INDEX edge_end ON edge (object_id, end_vertex);

-- data: byte layout in db/blob.h.
CREATE TABLE mesh (
  object_id TEXT PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  data BLOB NOT NULL
) STRICT;

-- object_from_object, x -> R x + t; R row by row.
CREATE TABLE symmetry (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  idx INTEGER NOT NULL CHECK (idx >= 0),
  r11 REAL NOT NULL, r12 REAL NOT NULL, r13 REAL NOT NULL,
  r21 REAL NOT NULL, r22 REAL NOT NULL, r23 REAL NOT NULL,
  r31 REAL NOT NULL, r32 REAL NOT NULL, r33 REAL NOT NULL,
  tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
  PRIMARY KEY (object_id, idx)
) STRICT, WITHOUT ROWID;

-- object_from_gripper, x -> R x + t; R row by row.
CREATE TABLE grasp (
  object_id TEXT NOT NULL REFERENCES object ON DELETE CASCADE,
  idx INTEGER NOT NULL CHECK (idx >= 0),
  r11 REAL NOT NULL, r12 REAL NOT NULL, r13 REAL NOT NULL,
  r21 REAL NOT NULL, r22 REAL NOT NULL, r23 REAL NOT NULL,
  r31 REAL NOT NULL, r32 REAL NOT NULL, r33 REAL NOT NULL,
  tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
  name TEXT NOT NULL,
  jaw_opening_m REAL NOT NULL,
  grip_width_m REAL NOT NULL,
  quality REAL NOT NULL,
  PRIMARY KEY (object_id, idx),
  UNIQUE (object_id, name)
) STRICT, WITHOUT ROWID;

-- The CAD file an object was made from, byte for byte.
CREATE TABLE cad_source (
  object_id TEXT PRIMARY KEY REFERENCES object ON DELETE CASCADE,
  file_name TEXT NOT NULL,
  format TEXT NOT NULL,
  unit TEXT NOT NULL,
  sha256 TEXT NOT NULL,  -- 64 lower-case hex digits, '' without content
  content BLOB NOT NULL
) STRICT;
