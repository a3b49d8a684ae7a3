"""What others publish, read: folders of COCO and IOHprofiler as a study beside ours."""
