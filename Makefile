# Regenerates splitslam/wire from proto/. protoc's imports follow the proto path; ours live in splitslam/wire.
