"""Trains posed's keypoint nets and detector from BOP-format images with known relative camera poses."""
