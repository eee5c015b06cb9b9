"""`via topic`, `service`, `action`, `param`, `node`, `lifecycle` and `launch`: the `ros2` commands that wheels lack."""
