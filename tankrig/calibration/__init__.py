"""What has to be measured once: pump, camera, projector. One file for each."""
